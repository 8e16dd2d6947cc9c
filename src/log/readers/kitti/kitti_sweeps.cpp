// SPDX-License-Identifier: Apache-2.0
// Reconstructs the rays of an HDL-64E from KITTI scans. The order in the file gives the
// rings. Fits to the points give the beam elevations and the firing angles. Then each
// point is assigned to its ray. Rays without a point are dropped rays.
#include "log/readers/kitti/kitti_sweeps.hpp"

#include <algorithm>
#include <cmath>

#include <fmt/format.h>

#include <relidar/base/error.hpp>
#include <relidar/base/math.hpp>
#include <relidar/log/clouds.hpp>

#include "base/parallel.hpp"
#include "base/progress_blocks.hpp"
#include "log/clouds/broken_scans.hpp"
#include "log/clouds/log_files.hpp"
#include "log/readers/kitti/firing_lattice.hpp"

namespace relidar::kitti {
namespace {

// Number of scans for fitting the sensor. The fit to a few scans is already far more
// accurate than the coordinates in the files, which are rounded to millimetres.
constexpr std::size_t kFitScans = 6, kLatticeScans = 3;

std::vector<const RawScan*> select_evenly_spaced_scans(const std::vector<RawScan>& scans, std::size_t count) {
    std::vector<const RawScan*> some;
    count = std::min(count, scans.size());
    for (std::size_t i = 0; i < count; ++i) some.push_back(&scans[i * scans.size() / count]);
    return some;
}

/// Reads a scan file and splits its points into rings.
/// @param labels  folder of the label files; empty if the points have no labels
RawScan read_raw_scan(const std::filesystem::path& file, const std::filesystem::path& labels) {
    ScanPoints scan =
        read_scan(file, labels.empty() ? labels : labels / file.filename().replace_extension(".label"));
    RawScan raw = split_points_into_rings(std::move(scan.points));
    raw.classes = std::move(scan.classes);
    return raw;
}

Points make_points(const RawScan& raw) {
    Points points;
    for (const glm::vec4& p : raw.points) points.position_m.emplace_back(p), points.intensity.push_back(p.w);
    points.ring.assign(raw.ring.begin(), raw.ring.end());
    points.classes = raw.classes;
    return points;
}

/// Returns the azimuth of the last point of a scan, from 0 to 360 degrees. Azimuths
/// increase from 0 in each ring, so a complete scan ends near 360.
double get_last_azimuth_deg(const RawScan& scan) {
    if (scan.points.empty()) return 0.0;
    // The scan is complete: a stray point after its last ring has started another ring.
    if (scan.n_rings > kRings) return 360.0;
    const double azimuth =
        std::atan2(double(scan.points.back().y), double(scan.points.back().x)) * 180.0 / kPi;
    return azimuth < 0.0 ? azimuth + 360.0 : azimuth;
}

/// Detects damaged files by comparing each scan with its neighbours. Otherwise, the
/// missing points of a damaged file would be treated as dropped rays.
class ScanSizes {
public:
    explicit ScanSizes(const std::vector<RawScan>& raw) {
        for (const RawScan& scan : raw) {
            n_points_.push_back(scan.points.size());
            n_rings_.push_back(scan.n_rings);
            end_deg_.push_back(get_last_azimuth_deg(scan));
        }
    }

    /// Returns why scan `index` is incomplete, or an empty string if it is complete. An
    /// incomplete scan has far fewer points or rings than its neighbours, or its last
    /// ring ends much earlier.
    std::string explain_incomplete_scan(std::size_t index, const std::string& file) const {
        // A single missing ring is accepted, because one beam may have no returns.
        constexpr int kMissingRings = 2;
        // In complete scans, the azimuth at the end of the last ring varies by up to 20
        // degrees.
        constexpr double kEarly_deg = 60.0;
        if (n_points_[index] == 0) return fmt::format("{}: the scan has no returns", file);
        if (const std::size_t usual = compute_median_of_neighbours(n_points_, index);
            2 * n_points_[index] < usual)
            return fmt::format("{}: the scan has {} points, but the neighbouring scans have {}", file,
                               n_points_[index], usual);
        if (const int usual = compute_median_of_neighbours(n_rings_, index);
            n_rings_[index] + kMissingRings <= usual)
            return fmt::format(
                "{}: the points of the scan end in ring {}, but those of the neighbouring scans end in "
                "ring {}",
                file, n_rings_[index], usual);
        if (const double usual_deg = compute_median_of_neighbours(end_deg_, index);
            end_deg_[index] + kEarly_deg <= usual_deg)
            return fmt::format(
                "{}: the last ring of the scan ends at azimuth {:.0f} degrees, but that of the "
                "neighbouring scans ends at {:.0f} degrees",
                file, end_deg_[index], usual_deg);
        return "";
    }

private:
    std::vector<std::size_t> n_points_;
    std::vector<int> n_rings_;
    std::vector<double> end_deg_;

    /// Returns the median over up to five scans on each side of scan `index`.
    template <class T>
    static T compute_median_of_neighbours(const std::vector<T>& values, std::size_t index) {
        constexpr std::size_t kReach = 5;
        const std::size_t begin = index < kReach ? 0 : index - kReach,
                          end = std::min(values.size(), index + kReach + 1);
        std::vector<T> neighbours;
        for (std::size_t k = begin; k < end; ++k)
            if (k != index && values[k] > 0) neighbours.push_back(values[k]);
        if (neighbours.empty()) return values[index];
        std::ranges::sort(neighbours);
        return neighbours[neighbours.size() / 2];
    }
};

/// Scales intensities of 0 to 255 to the range 0 to 1.
/// @return a note for the user; empty if the intensities are already in the range 0 to 1
/// @throws DataError if the intensities are in neither range
std::string normalise_intensities(std::vector<RawScan>& raw, const std::string& folder) {
    constexpr float kBytes = 255.0f;
    // Fractional intensities up to this value could be percentages, so they are rejected.
    constexpr float kPercent = 100.0f;
    float lowest = 0.0f, highest = 0.0f;
    bool are_whole = true;
    for (const RawScan& scan : raw)
        for (const glm::vec4& p : scan.points) {
            lowest = std::min(lowest, p.w), highest = std::max(highest, p.w);
            are_whole = are_whole && p.w == std::floor(p.w);
        }
    if (lowest >= 0.0f && highest <= 1.0f) return "";
    if (lowest < 0.0f || highest > kBytes || (!are_whole && highest <= kPercent))
        throw DataError(
            fmt::format("{}: found intensities from {} to {}, expected 0 to 1, or whole numbers up to 255",
                        folder, lowest, highest));
    for (RawScan& scan : raw)
        for (glm::vec4& p : scan.points) p.w /= kBytes;
    return fmt::format("intensities are {} up to {}, so they are divided by 255",
                       are_whole ? "whole numbers" : "numbers", highest);
}

/// Checks the numbers of firings and rays before memory is allocated for the rays.
/// @throws DataError if there are too many firings per sweep or rays per point
void check_rays(const std::vector<RawScan>& raw, const FiringLattice& lattice, const std::string& location) {
    constexpr int kMostFirings = 8192;            // an HDL-64E has up to 4170 firings per sweep
    constexpr std::size_t kMostRaysAPoint = 200;  // a complete sweep has about 1.1 rays per point
    if (lattice.head.n_ticks > kMostFirings)
        throw DataError(
            fmt::format("{}: azimuths of neighbouring points differ by 1/{} of a sweep, expected at most "
                        "{} firings per sweep of an HDL-64E",
                        location, lattice.head.n_ticks, kMostFirings));
    std::size_t n_points = 0;
    for (const RawScan& scan : raw) n_points += scan.points.size();
    const std::size_t n_rays =
        raw.size() * kRings * std::size_t(lattice.every_tick ? lattice.head.n_ticks : 1);
    if (n_rays > kMostRaysAPoint * n_points)
        throw DataError(fmt::format("{}: found {} points in {} sweeps of {} rays, expected complete sweeps",
                                    location, n_points, raw.size(), n_rays / raw.size()));
}

}  // namespace

void read_sweeps(Sequence& sequence, const std::filesystem::path& folder, int digits,
                 const DatasetOptions& options, const std::filesystem::path& labels) {
    const Progress& progress = options.progress;
    BrokenScans broken(options.skip_broken);
    const auto file_of = [&](std::size_t at) {
        return folder / fmt::format("{:0{}d}.bin", sequence.frames[at].index, digits);
    };
    std::vector<RawScan> raw(sequence.frames.size());
    for_each_with_progress(raw.size(), progress, "reading scans", [&](std::size_t at) {
        broken.attempt(at, [&] { raw[at] = read_raw_scan(file_of(at), labels); });
    });
    const ScanSizes scan_sizes(raw);
    for (std::size_t at = 0; at < raw.size(); ++at)
        if (const std::string why =
                broken.has(at) ? "" : scan_sizes.explain_incomplete_scan(at, file_of(at).string());
            !why.empty())
            broken.add(at, why + "; the file is probably truncated or damaged");
    if (broken.size() == raw.size()) broken.add_broken_scan_notes(sequence, raw.size());
    for (std::size_t at = 0; at < raw.size(); ++at)
        // Removes the points of a broken scan, so that the fits below ignore it.
        if (broken.has(at)) raw[at] = {};
    if (std::string note = normalise_intensities(raw, folder.string()); !note.empty())
        sequence.notes.push_back(std::move(note));

    const Cones cones = fit_cones(select_evenly_spaced_scans(raw, kFitScans), folder.string());
    parallel_for(static_cast<int>(raw.size()),
                 [&](int index) { correct_ring_numbers(raw[static_cast<std::size_t>(index)], cones); });
    const FiringLattice lattice = fit_lattice(select_evenly_spaced_scans(raw, kLatticeScans));
    check_rays(raw, lattice, folder.string());

    std::vector<std::vector<int>> firings(raw.size());
    for_each_with_progress(raw.size(), progress, "computing the firings of each sweep", [&](std::size_t at) {
        broken.attempt(at, [&] {
            firings[at] = find_firings(raw[at], lattice);
            if (firings[at].empty())
                throw DataError(
                    fmt::format("{}: found {} points that do not share firings, expected a sweep of an "
                                "HDL-64E",
                                file_of(at).string(), raw[at].points.size()));
        });
    });
    SpinningSensor& sensor = sequence.lidars[0].sensor;
    sensor.beams = lattice.beams(cones);
    for (const auto& sweep : firings)
        sensor.columns = std::max(sensor.columns, static_cast<int>(sweep.size()));
    sensor.first_azimuth_rad = kPi - kPi / sensor.columns;
    for_each_with_progress(raw.size(), progress, "assigning points to the fired rays", [&](std::size_t at) {
        if (!broken.has(at))
            sequence.frames[at].scan =
                make_spinning_scan(make_points(raw[at]), sensor, {lattice.head, firings[at]});
        raw[at] = {};
    });
    broken.leave_out(sequence);
}

}  // namespace relidar::kitti
