// SPDX-License-Identifier: Apache-2.0
// The sensor is recovered from its own scans: rings by file order, cones of the beams, the lattice of firings. Then every sweep is put on
// the rays that were fired.
#include "dataset/kitti/kitti_sweeps.hpp"

#include <algorithm>

#include <fmt/format.h>

#include <relidar/error.hpp>
#include <relidar/reader.hpp>

#include "core/parallel.hpp"
#include "core/progress_blocks.hpp"
#include "dataset/broken_scans.hpp"
#include "dataset/kitti/firing_lattice.hpp"
#include "dataset/kitti/kitti_files.hpp"

namespace relidar::kitti {
namespace {

// The fits are far better than the file's millimetres with a few sweeps; more would only cost time.
constexpr std::size_t kFitScans = 6, kLatticeScans = 3;

std::vector<const RawScan*> spread(const std::vector<RawScan>& scans, std::size_t n) {
    std::vector<const RawScan*> some;
    n = std::min(n, scans.size());
    for (std::size_t i = 0; i < n; ++i) some.push_back(&scans[i * scans.size() / n]);
    return some;
}

ScanPoints points_of(const RawScan& raw) {
    ScanPoints points;
    for (const glm::vec4& p : raw.points) points.point_m.emplace_back(p), points.intensity.push_back(p.w);
    points.ring.assign(raw.ring.begin(), raw.ring.end());
    return points;
}

/// Before rays are made: as many as the azimuths say, and no more than the points can be returns of.
void check_rays(const std::vector<RawScan>& raw, const FiringLattice& lattice, const std::string& where) {
    constexpr int kMostFirings = 8192;            // an HDL-64E has up to 4170 a sweep
    constexpr std::size_t kMostRaysAPoint = 200;  // whole sweeps have 1.1
    if (lattice.head.n_ticks > kMostFirings)
        throw DataError(
            fmt::format("{}: azimuths of neighbouring points differ by 1/{} of a sweep, expected at most {} firings of an HDL-64E", where,
                        lattice.head.n_ticks, kMostFirings));
    std::size_t n_points = 0;
    for (const RawScan& scan : raw) n_points += scan.points.size();
    const std::size_t n_rays = raw.size() * kRings * std::size_t(lattice.every_tick ? lattice.head.n_ticks : 1);
    if (n_rays > kMostRaysAPoint * n_points)
        throw DataError(
            fmt::format("{}: {} points in {} sweeps of {} rays, expected whole sweeps", where, n_points, raw.size(), n_rays / raw.size()));
}

}  // namespace

void read_sweeps(Sequence& sequence, const std::filesystem::path& folder, int digits, const DatasetOptions& options) {
    const Progress& progress = options.progress;
    BrokenScans broken(options.skip_broken);
    const auto file_of = [&](std::size_t at) { return folder / fmt::format("{:0{}d}.bin", sequence.frames[at].index, digits); };
    std::vector<RawScan> raw(sequence.frames.size());
    for_each_told(raw.size(), progress, "reading scans", [&](std::size_t at) {
        broken.attempt(at, [&] { raw[at] = split_rings(read_scan(file_of(at))); });
    });

    const Cones cones = fit_cones(spread(raw, kFitScans), folder.string());
    run_parallel(static_cast<int>(raw.size()), [&](int i) { correct_rings(raw[static_cast<std::size_t>(i)], cones); });
    const FiringLattice lattice = fit_lattice(spread(raw, kLatticeScans));
    check_rays(raw, lattice, folder.string());

    std::vector<std::vector<int>> firings(raw.size());
    for_each_told(raw.size(), progress, "finding the firings of each sweep", [&](std::size_t at) {
        broken.attempt(at, [&] {
            firings[at] = find_firings(raw[at], lattice);
            if (firings[at].empty())
                throw DataError(fmt::format("{}: {} points without a firing in common, expected a sweep of an HDL-64E",
                                            file_of(at).string(), raw[at].points.size()));
        });
    });
    SpinningSensor& sensor = sequence.lidars[0].sensor;
    sensor.beams = lattice.beams(cones);
    for (const auto& sweep : firings) sensor.columns = std::max(sensor.columns, static_cast<int>(sweep.size()));
    sensor.first_azimuth_rad = kPi - kPi / sensor.columns;
    for_each_told(raw.size(), progress, "putting points on the rays that were fired", [&](std::size_t at) {
        if (!broken.has(at)) sequence.frames[at].scan = spinning_scan(points_of(raw[at]), sensor, {lattice.head, firings[at]});
        raw[at] = {};
    });
    broken.leave_out(sequence);
}

}  // namespace relidar::kitti
