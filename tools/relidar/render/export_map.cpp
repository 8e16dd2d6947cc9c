// SPDX-License-Identifier: Apache-2.0
// `relidar export --points` merges the points of all scans of the background to a map.
#include "render/export_map.hpp"

#include <array>
#include <cmath>
#include <map>

#include <fmt/format.h>

#include <relidar/run/run.hpp>
#include <relidar/run/stage_options.hpp>
#include <relidar/simulate/place_points.hpp>
#include <relidar/simulate/point_files.hpp>
#include <relidar/simulate/render.hpp>
#include "base/fail.hpp"
#include "console.hpp"
#include "interrupt.hpp"
#include "output_folder.hpp"
#include "render/choose_frames.hpp"
#include "render/target_sensors.hpp"

namespace relidar::cli {
namespace {

struct MapCell {
    glm::dvec3 sum_m{0.0};  ///< relative to the origin
    double intensity = 0.0;
    std::size_t n = 0;
};

/// Means of the points of each cell of a grid.
class PointMap {
public:
    /// @param origin_m of the points in the dataset's world, in which the grid begins
    PointMap(const glm::dvec3& origin_m, double spacing_m) : origin_m_(origin_m), spacing_m_(spacing_m) {}

    void add_points(const LidarPoints& points) {
        for (std::size_t i = 0; i < points.size(); ++i) {
            const glm::dvec3 p(points.position_m[i]), cell = glm::floor((origin_m_ + p) / spacing_m_);
            MapCell& mean = cells_[{cell.x, cell.y, cell.z}];
            mean.sum_m += p;
            mean.intensity += double(points.intensity[i]);
            ++mean.n;
        }
    }
    LidarPoints mean_points() const {
        LidarPoints map;
        for (const auto& [key, cell] : cells_) {
            map.position_m.emplace_back(cell.sum_m / double(cell.n));
            map.intensity.push_back(float(cell.intensity / double(cell.n)));
        }
        return map;
    }

private:
    glm::dvec3 origin_m_;
    double spacing_m_;
    std::map<std::array<double, 3>, MapCell> cells_;
};

}  // namespace

void export_map(const MapOptions& options) {
    constexpr double kMinSpacing_m = 1e-3, kMaxSpacing_m = 100.0;
    const std::filesystem::path out = options.file;
    const std::string ending = out.extension().string();
    if (ending != ".las" && ending != ".ply" && ending != ".pcd")
        fail<UsageError>("--points {}: found the ending \"{}\"; expected .las, .ply or .pcd", options.file,
                         ending);
    if (!(options.spacing_m >= kMinSpacing_m && options.spacing_m <= kMaxSpacing_m))
        fail<UsageError>("--spacing: found {}; expected metres from {} to {}", options.spacing_m,
                         kMinSpacing_m, kMaxSpacing_m);
    const OutputFolder folder(out.has_parent_path() ? out.parent_path() : ".");
    Run run = load_run(options.run);
    run.config = with_max_range(std::move(run.config), run.sequence);
    const Log& log = run.sequence;
    std::vector<int> positions = select_frames(run, options.frames.value_or("all"), options.quiet);
    std::vector<SimulatedSensor> sensors;
    for (std::size_t lidar = 0; lidar < log.lidars.size(); ++lidar)
        sensors.push_back(list_sensors("", {}, run, int(lidar)).front().sensor);
    for (const SimulatedSensor& sensor : sensors) {
        if (sensor.rays.size() > 0 || sensor.pattern) continue;
        print_note(fmt::format("the map is without {}, whose rays are unknown", sensor.name));
        std::erase_if(positions,
                      [&](int position) { return log.frames[std::size_t(position)].lidar == sensor.lidar; });
    }
    if (positions.empty())
        fail<UsageError>("--points: found no scan with known rays, expected frames of a LiDAR that spins");
    Device device(to_device_options(options.device));
    ScanRenderer renderer(device, run);
    renderer.show_instances(select_instances(run.scene, {"background"}));
    install_handlers();
    TerminalProgress progress(options.quiet);
    PointMap map(log.world_offset_m, options.spacing_m);
    for (std::size_t done = 0; done < positions.size(); ++done) {
        check_interrupt();
        progress.show_step("rendering the map", done, positions.size());
        const Frame& frame = log.frames[std::size_t(positions[done])];
        const RenderedScan scan = renderer.render(sensors[std::size_t(frame.lidar)], frame.time_s, Pose{});
        map.add_points(place_points(scan, run.config, Pose{{1, 0, 0, 0}, log.world_offset_m}));
    }
    end_progress();
    const LidarPoints points = map.mean_points();
    const FileMetadata notes{{"relidar", RELIDAR_VERSION},
                             {"run", absolute_path(options.run)},
                             {"spacing_m", fmt::format("{}", options.spacing_m)}};
    const bool is_on_earth = log.georeference && has_proj();
    if (ending == ".ply") write_ply(out, points, notes, log.world_offset_m);
    else if (ending == ".pcd") write_pcd(out, points, notes, log.world_offset_m);
    else
        write_las(out, points, notes, log.world_offset_m,
                  is_on_earth ? GeoConverter(*log.georeference).wkt() : "");
    if (!options.quiet)
        print(fmt::format("{}: {} points of {} scans\n", absolute_path(options.file), points.size(),
                          positions.size()));
}

}  // namespace relidar::cli
