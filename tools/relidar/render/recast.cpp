// SPDX-License-Identifier: Apache-2.0
#include "render/recast.hpp"

#include <algorithm>
#include <charconv>
#include <cmath>

#include <fmt/format.h>

#include <relidar/base/error.hpp>
#include <relidar/log/dataset.hpp>
#include <relidar/simulate/render.hpp>

#include "base/fail.hpp"

namespace relidar::cli {
namespace {

constexpr float kSameRange_m = 0.01f;
constexpr const char* kKind = "synthetic:";

/// Returns the folder of the synthetic street. The dataset path starts with a prefix such
/// as "synthetic:", which is removed.
std::filesystem::path get_synthetic_street_folder(const TrainedRun& run) {
    const std::string& path = run.config.dataset.path;
    return path.starts_with(kKind) ? path.substr(std::string(kKind).size()) : path;
}

/// Returns the number of the synthetic car from which a model was trained. The model's
/// name is this number. Edits of the scene do not change the name.
std::size_t get_synthetic_car_number_of_model(const SurfelModel& model,
                                              const std::string& track_id_for_errors) {
    std::size_t car = 0;
    const auto [end, error] = std::from_chars(model.name.data(), model.name.data() + model.name.size(), car);
    if (error != std::errc() || end != model.name.data() + model.name.size())
        fail(
            "cannot render the edited street: the model of track {} has the name \"{}\"; expected a whole "
            "number, because the models of a synthetic street are named by the numbers of its cars",
            track_id_for_errors, model.name);
    return car;
}

std::vector<SyntheticCar> list_synthetic_cars(const TrainedRun& run) {
    std::vector<SyntheticCar> cars;
    for (const ModelInstance& instance : run.scene.instances) {
        const BoxTrack* box = find_box_track_by_id(run.sequence, instance.track);
        if (box)
            cars.push_back(
                {get_synthetic_car_number_of_model(run.scene.models[instance.model], instance.track), *box});
    }
    return cars;
}

}  // namespace

bool is_edited_synthetic_street_run(const TrainedRun& run) {
    if (run.edits.empty()) return false;
    const std::string& path = run.config.dataset.path;
    return path.starts_with(kKind) ||
           std::filesystem::exists(get_synthetic_street_folder(run) / "street.toml");
}

std::vector<Scan> set_noise_free_scans_and_get_unedited_scans(TrainedRun& run) {
    const SyntheticOptions street = read_synthetic_options(get_synthetic_street_folder(run));
    const std::vector<SyntheticCar> cars = list_synthetic_cars(run);
    const RayTable rays = make_rays(run.sequence.lidars[0].sensor);
    const RangeLimits limits = make_sensor_from_config(run.config, run.sequence).limits;
    // uses LiDAR 0, because a synthetic street has exactly one LiDAR
    const PoseTrack track = run.sequence.get_world_from_sensor(0);
    std::vector<Scan> before;
    for (const int position : run.split.test) {
        LidarFrame& frame = run.sequence.frames[static_cast<std::size_t>(position)];
        frame.scan = cast_rays_into_synthetic_street(street, cars, rays, track, frame.time_s);
        before.push_back(cast_rays_into_synthetic_street(street, rays, track, frame.time_s));
        for (Scan* scan : {&frame.scan, &before.back()}) remove_returns_outside_limits(*scan, limits);
    }
    return before;
}

PixelRegion find_pixels_changed_by_edit(const RangeImage& edited_image, const RangeImage& original_image) {
    PixelRegion region{"edited", std::vector<bool>(edited_image.range_m.size())};
    for (std::size_t i = 0; i < region.pixels.size(); ++i)
        region.pixels[i] = std::abs(edited_image.range_m[i] - original_image.range_m[i]) > kSameRange_m;
    return region;
}

}  // namespace relidar::cli
