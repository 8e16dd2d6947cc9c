// SPDX-License-Identifier: Apache-2.0
// relidar_bench_edited scores an edited run of a synthetic street. It casts rays into the
// exact street after the same edits, without noise, and compares the pixels of held-out
// frames that the edits change. tools/bench/edits calls it.
#include <charconv>
#include <cmath>
#include <vector>

#include <fmt/format.h>

#include <relidar/base/error.hpp>
#include <relidar/gpu/device.hpp>
#include <relidar/read/dataset.hpp>
#include <relidar/run/run.hpp>
#include <relidar/run/stage_options.hpp>
#include <relidar/score/evaluation.hpp>

#include "street_of.hpp"

namespace {

using namespace relidar;

constexpr float kSameRange_m = 0.01f;

/// Returns the cars of the street at their edited poses. A model has the number of its
/// synthetic car as name; edits keep this name.
std::vector<SyntheticCar> list_cars_of_run(const Run& run) {
    std::vector<SyntheticCar> cars;
    for (const ModelInstance& instance : run.scene.instances) {
        const BoxTrack* box = find_box(run.log, instance.track);
        if (!box) continue;
        const std::string& name = run.scene.models[instance.model].name;
        std::size_t car = 0;
        const char* const end = name.data() + name.size();
        const auto [stop, error] = std::from_chars(name.data(), end, car);
        if (error != std::errc() || stop != end)
            throw DataError(
                fmt::format("the model of track {} has the name \"{}\", expected the number of a car",
                            instance.track, name));
        cars.push_back({car, *box});
    }
    return cars;
}

/// Scores an edited run on the pixels that the edits have changed. The truth is a scan of
/// the synthetic street with its cars at the edited poses.
void print_edited_scores(const std::string& folder) {
    Run run = load_run(folder);
    run.config = with_max_range(std::move(run.config), run.log);
    const StreetOptions street = read_street(run);
    const std::vector<SyntheticCar> cars = list_cars_of_run(run);
    const RayTable rays = make_rays(run.log.lidars[0].sensor);
    const RangeLimits limits = make_sensor(run.config, run.log).limits;
    const PoseTrack track = run.log.lidar_track(0);
    for (const int position : run.split.test) {
        Frame& frame = run.log.frames[std::size_t(position)];
        frame.scan = cast_street_rays(street, cars, rays, track, frame.time_s);
        limit_ranges(frame.scan, limits);
    }

    Device device(apply_environment({}));
    ScanRenderer renderer(device, run);
    std::vector<MetricValues> scores;
    const auto score_frame = [&](const ScoredFrame& frame) {
        Scan unedited_street = cast_street_rays(street, rays, track, frame.time_s);
        limit_ranges(unedited_street, limits);
        const RangeImage unedited = measured_image(run.config, unedited_street);
        PixelRegion edited{"edited", std::vector<bool>(unedited.range_m.size())};
        for (std::size_t i = 0; i < edited.pixels.size(); ++i)
            edited.pixels[i] = std::abs(frame.real.range_m[i] - unedited.range_m[i]) > kSameRange_m;
        scores.push_back(evaluate_regions(frame.rendered.image, frame.real, {edited}));
    };
    evaluate_frames(renderer, run.config, run.log, run.split.test, {}, score_frame);
    MetricValues mean = mean_metrics(scores);
    for (const char* metric : {"pixels", "returned", "depth_medae_m", "depth_mae_m", "depth_rmse_m"})
        fmt::print("{:.4g} ", mean["edited/" + std::string(metric)]);
    fmt::print("\n");
}

}  // namespace

int main(int argc, char** argv) { return relidar::run_on_argument(argc, argv, print_edited_scores); }
