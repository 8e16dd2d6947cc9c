// SPDX-License-Identifier: Apache-2.0
#include "render/recast.hpp"

#include <algorithm>
#include <charconv>
#include <cmath>

#include <fmt/format.h>

#include <relidar/base/error.hpp>
#include <relidar/log/dataset.hpp>
#include <relidar/simulate/render.hpp>

namespace relidar::cli {
namespace {

constexpr float kSameRange_m = 0.01f;
constexpr const char* kKind = "synthetic:";

/// Returns the folder of the synthetic street. The dataset path starts with a prefix such
/// as "synthetic:", which is removed.
std::filesystem::path get_street_folder(const Run& run) {
    const std::string& path = run.config.dataset.path;
    return path.starts_with(kKind) ? path.substr(std::string(kKind).size()) : path;
}

/// Returns the number of the synthetic car from which a model was trained. The name of
/// the model is this number, even after an edit.
std::size_t find_car(const Model& model, const std::string& track) {
    std::size_t car = 0;
    const auto [end, error] = std::from_chars(model.name.data(), model.name.data() + model.name.size(), car);
    if (error != std::errc() || end != model.name.data() + model.name.size())
        throw DataError(fmt::format(
            "cannot render the edited street: track {} has the model \"{}\"; expected the number of "
            "a car of the synthetic street",
            track, model.name));
    return car;
}

std::vector<StreetCar> list_cars(const Run& run) {
    std::vector<StreetCar> cars;
    for (const Instance& instance : run.scene.instances) {
        const BoxTrack* box = find_box(run.sequence, instance.track);
        if (box) cars.push_back({find_car(run.scene.models[instance.model], instance.track), *box});
    }
    return cars;
}

}  // namespace

bool can_recast_scans(const Run& run) {
    if (run.edits.empty()) return false;
    const std::string& path = run.config.dataset.path;
    return path.starts_with(kKind) || std::filesystem::exists(get_street_folder(run) / "street.toml");
}

std::vector<Scan> attach_exact_scans(Run& run) {
    const SyntheticOptions street = read_synthetic(get_street_folder(run));
    const std::vector<StreetCar> cars = list_cars(run);
    const RayTable rays = make_rays(run.sequence.lidars[0].sensor);
    const RangeLimits limits = make_configured_sensor(run.config, run.sequence).limits;
    // uses LiDAR 0, because a synthetic street has exactly one LiDAR
    const PoseTrack track = run.sequence.world_from_sensor(0);
    std::vector<Scan> before;
    for (const int position : run.split.test) {
        Frame& frame = run.sequence.frames[static_cast<std::size_t>(position)];
        frame.scan = cast_synthetic_street(street, cars, rays, track, frame.time_s);
        before.push_back(cast_synthetic_street(street, rays, track, frame.time_s));
        for (Scan* scan : {&frame.scan, &before.back()}) drop_outside_limits(*scan, limits);
    }
    return before;
}

Region find_edited_region(const RangeImage& edited, const RangeImage& original) {
    Region region{"edited", std::vector<bool>(edited.range_m.size())};
    for (std::size_t i = 0; i < region.pixels.size(); ++i)
        region.pixels[i] = std::abs(edited.range_m[i] - original.range_m[i]) > kSameRange_m;
    return region;
}

}  // namespace relidar::cli
