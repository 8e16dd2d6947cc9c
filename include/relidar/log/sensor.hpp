// SPDX-License-Identifier: Apache-2.0
// What a LiDAR is: a table of rays. A spinning LiDAR is a generator for such a table, a
// range grid a convention for ordering points into an image. Sensor frame: x forward, y
// left, z up, metres.
#pragma once

#include <cstddef>
#include <cstdint>
#include <filesystem>
#include <limits>
#include <optional>
#include <string>
#include <string_view>
#include <variant>
#include <vector>

#include <glm/glm.hpp>

namespace relidar {

// Where the arrays of rays and scans lie. A log of 6000 scans is 30 GB, which few
// machines have: beyond a limit the arrays lie in a file that is mapped into memory, of
// which the system keeps what is in use. Scans are written once and then read frame by
// frame, so that this costs little.

/// How much the arrays of all scans of this process may take of its memory from now on.
/// What goes beyond lies in a file without a name in a folder, which ends with the
/// process. Unlimited until this is called.
/// @param bytes  0: half of what the machine, or the control group of the process, has,
/// shared with other processes (share_scan_memory())
/// @param folder  of the file, made where the first array goes there
void limit_scan_memory(std::uint64_t bytes, const std::filesystem::path& folder);

/// Says that so many processes of this machine hold scans; one until this is called.
void share_scan_memory(int n_processes);

/// Bytes of the arrays of all scans. Small ones (below 16 KiB) are not counted.
struct ScanMemoryUse {
    std::uint64_t in_memory = 0;
    std::uint64_t in_file = 0;
};
/// What they take now.
ScanMemoryUse scan_memory_use();

/// @throws DataError naming the folder where its disk is full or it cannot be written,
/// std::bad_alloc
void* allocate_scan_array(std::size_t bytes);
void free_scan_array(void* array, std::size_t bytes) noexcept;

/// Allocator of the arrays of scans.
template <class T>
struct ScanAllocator {
    using value_type = T;

    ScanAllocator() = default;
    template <class U>
    ScanAllocator(const ScanAllocator<U>&) {}
    T* allocate(std::size_t n) { return static_cast<T*>(allocate_scan_array(n * sizeof(T))); }
    void deallocate(T* array, std::size_t n) noexcept { free_scan_array(array, n * sizeof(T)); }
    bool operator==(const ScanAllocator&) const { return true; }
};

/// A value for each ray of a scan.
template <class T>
using ScanArray = std::vector<T, ScanAllocator<T>>;

/// A copy in memory.
template <class T>
std::vector<T> to_vector(const ScanArray<T>& values) {
    return {values.begin(), values.end()};
}

/// And back.
template <class T>
ScanArray<T> to_scan_array(const std::vector<T>& values) {
    return {values.begin(), values.end()};
}

/// A table of rays in range-image order; ray (row, column) is entry row * columns +
/// column, row 0 the highest beam, column 0 at azimuth +180 degrees, azimuth falling with
/// the column. A sensor without image order has rows = 1.
struct RayTable {
    int rows = 0;
    int columns = 0;
    ScanArray<glm::vec3> origin;       ///< [rows*columns] metres, sensor frame: where the beam starts
    ScanArray<glm::vec3> direction;    ///< [rows*columns] unit, sensor frame
    ScanArray<float> time_offset_s;    ///< [rows*columns] firing time relative to the frame's reference time
    ScanArray<std::uint16_t> channel;  ///< [rows*columns] beam number, 0 = highest
    float divergence_rad = 0.0f;       ///< full beam divergence of all; 0 = ideal ray
    /// [rows*columns] of each, in place of the one; empty where all have the same
    ScanArray<float> ray_divergence_rad = {};

    std::size_t size() const { return direction.size(); }
    double divergence_of(std::size_t ray) const {
        return ray_divergence_rad.empty() ? divergence_rad : ray_divergence_rad[ray];
    }
    double largest_divergence() const;  ///< 0 where all are ideal rays
    /// Adds a ray of another table, from which all of this one's are; rows and columns
    /// stay.
    void append(const RayTable& from, std::size_t ray);
};
/// Offsets across a beam of the rays that stand for its footprint, [n] in units of half
/// its divergence: its own ray first, the others so that, all weighted alike, their
/// spread is that of a disc that is lit evenly, mean of offset^2 = 1/2.
/// @param n  1, 5 or 9; any other number is a spiral, whose first ray lies beside the
/// middle
std::vector<glm::dvec2> footprint_pattern(int n);
/// Some rays of a table, without image order.
RayTable some_rays(const RayTable& rays, const std::vector<std::size_t>& wanted);

/// One beam of a spinning LiDAR. The ray of a head at azimuth `theta` (counter-clockwise)
/// points along elevation_rad, azimuth theta + azimuth_offset_rad, and starts at
///   R_z(theta) * (origin_offset_m, 0, 0)
///   + R_z(theta + azimuth_offset_rad) * (-origin_up_m * sin(elevation), origin_left_m, origin_up_m * cos(elevation))
struct Beam {
    double elevation_rad = 0.0;
    double azimuth_offset_rad = 0.0;
    double origin_offset_m = 0.0;  ///< along the head direction
    double origin_up_m = 0.0;      ///< at right angles to the beam, in its vertical plane
    double origin_left_m = 0.0;    ///< to the left of the beam
    double intensity_gain = 1.0;
    double intensity_offset = 0.0;
    double range_offset_m = 0.0;

    /// What the beam measures of a surface and back:
    ///   measured range = range of the surface + range_offset,
    ///   measured intensity = gain * fall * intensity of the surface + offset, cut to 0..1
    /// A range of 0, no return, stays 0. The two directions are inverse where nothing is
    /// cut.
    /// @param fall  of the log's IntensityResponse at the range of the surface
    double measured_range(double surface_m) const;
    double surface_range(double measured_m) const;  ///< at least 1 mm
    double measured_intensity(double of_surface, double fall) const;
    double surface_intensity(double measured, double fall) const;
};

/// The beam of a channel; one that measures what is there where there is no such beam.
const Beam& beam_of(const std::vector<Beam>& beams, std::size_t channel);

/// Ranges at which a sensor sees anything. A ray whose range lies outside is dropped.
struct RangeLimits {
    double min_m = 0.0;
    double max_m = std::numeric_limits<double>::infinity();

    /// A range of 0 means that the ray met nothing, and is never within limits.
    bool contains(double range_m) const { return range_m > 0.0 && range_m >= min_m && range_m <= max_m; }
};
/// What lies within both.
RangeLimits overlap(const RangeLimits& a, const RangeLimits& b);

/// A spinning LiDAR: its beams, the number of azimuth steps a sweep, and the sweep
/// itself.
struct SpinningSensor {
    std::string name;
    std::vector<Beam> beams;  ///< highest first
    int columns = 0;          ///< azimuth steps a sweep
    double period_s = 0.1;    ///< time of one sweep; 0: it does not turn
    bool clockwise = true;    ///< seen from above
    /// azimuth of the centre of column 0 (pi - pi/columns: bins centred on half steps)
    double first_azimuth_rad = 0.0;
    double min_range_m = 0.0;
    double max_range_m = 80.0;
    double divergence_rad = 0.0;

    RangeLimits range_limits() const { return {min_range_m, max_range_m}; }
};

/// Where a beam starts and points, sensor frame.
struct BeamRay {
    glm::dvec3 origin_m;
    glm::dvec3 direction;
};

/// Ray of one beam while the head stands at an azimuth, by the equation of Beam.
BeamRay beam_ray(const Beam& beam, double head_azimuth_rad);

/// Azimuth of the head at which a beam meets a point: the inverse of beam_ray(). @param
/// point_m [3] metres, sensor frame @return not wrapped
double head_azimuth(const Beam& beam, const glm::dvec3& point_m);

/// Columns by which a beam's firings are moved in the image, so that a column keeps one
/// azimuth: image column j holds firing (j + shift) mod columns, shift = azimuth_offset
/// in columns, rounded.
int column_shift(const Beam& beam, int columns);

/// Rays of one sweep. Time 0 is the moment the head faces forward (azimuth 0); a
/// clockwise head reaches azimuth a at -a / (2 pi) * period.
/// @throws UsageError where the sensor has no beams, no columns, more than kMaxRays rays,
/// a non-finite value or no range between its limits
RayTable make_rays(const SpinningSensor& sensor);
/// of one sweep: 128 beams at 0.003 degrees; 500 MB as rays and their scan
inline constexpr std::size_t kMaxRays = std::size_t(1) << 24;

/// Sensor-level ray-drop (paper section 3.5): what a sensor never sees whatever stands
/// there, such as the body of its own vehicle, as a probability a beam and azimuth bin.
/// Independent of the scene: P(drop) = 1 - (1 - scene's) (1 - sensor's).
struct DropTable {
    int channels = 0;
    int bins = 0;                    ///< of azimuth, bin 0 begins at +180 degrees, falling
    std::vector<float> probability;  ///< [channels, bins]

    bool empty() const { return probability.empty(); }
    /// Index of a ray's entry. @param direction [3] sensor frame
    std::size_t index(std::uint16_t channel, const glm::vec3& direction) const;
    /// @return 0 where the table is empty or has no such channel
    float at(std::uint16_t channel, const glm::vec3& direction) const;
};

/// A linear image of elevation by azimuth. Pixel (i, j) is centred on elevation fov_up -
/// i * fov / rows and azimuth 180 - j * 360 / columns degrees. (as the KITTI-360 grid has
/// it)
struct RangeGrid {
    std::string name;
    int rows = 0;
    int columns = 0;
    double fov_up_rad = 0.0;  ///< elevation of row 0
    double fov_rad = 0.0;     ///< total vertical field of view
    double max_range_m = 80.0;
};

/// The KITTI-360 convention of published results: 66 x 1030, +2.0 ... -24.9 degrees, 80
/// m.
RangeGrid kitti360_grid();

/// Rays through the pixel centres of a grid, starting at the sensor origin; clockwise,
/// 0.1 s a sweep.
RayTable make_rays(const RangeGrid& grid);

/// Nearest pixel of a point, the forward half of the sensor model (Eq. 6-7).
/// @param point_m [3] metres, sensor frame
/// @return row * columns + column, or nothing outside the vertical field of view, at
/// range 0 or beyond max_range_m
/// @differs Eq. 7 as printed divides |f_down| alone by f_v; Eq. 6 writes arctan(y, x),
/// arcsin(z, d).
std::optional<int> project(const RangeGrid& grid, const glm::dvec3& point_m);

/// A range image gathered by projecting points: the nearest point wins a pixel.
struct GridImage {
    int rows = 0;
    int columns = 0;
    std::vector<float> range_m;    ///< [rows*columns] 0 where no point fell
    std::vector<float> intensity;  ///< [rows*columns]
    std::vector<int> source;       ///< [rows*columns] index of the winning point, -1 where none
};

/// Projects points into a grid. @param points_m [n] metres, sensor frame @param intensity
/// [n]
GridImage project_points(const RangeGrid& grid, const std::vector<glm::vec3>& points_m,
                         const std::vector<float>& intensity);

/// A LiDAR whose beam is bent by two prisms that turn against each other: a flower of
/// petals about the x axis, other petals in every scan.
///   direction = (cos r, sin r cos p, sin r sin p),   r e^(ip) = deflection (e^(i 2 pi f1 t) + e^(i 2 pi f2 t)),
/// which is the paraxial form of a pair of thin prisms of equal wedge.
struct Rosette {
    std::string name;
    double deflection_rad = 0.0;  ///< by one prism: half of the cone's half angle
    /// of the prisms, positive counter-clockwise seen from behind the sensor
    double first_hz = 0.0, second_hz = 0.0;
    int n_rays = 0;  ///< of one scan, at even times
    double period_s = 0.1;
    double divergence_rad = 0.0;
};

/// Rays of the scan at a time, in the order of firing: rows = 1, channel 0, time offsets
/// from -period/2 to period/2.
/// @throws UsageError for no rays, more than kMaxRays, or a value that is not finite
RayTable make_rays(const Rosette& rosette, double time_s);

/// A LiDAR whose mirrors sweep a window: rows of even elevation, columns of even azimuth,
/// all rows of a column fired together.
struct ScanningWindow {
    std::string name;
    int rows = 0, columns = 0;
    double left_rad = 0.0, right_rad = 0.0;  ///< azimuths of the first and last column, left positive
    double top_rad = 0.0, bottom_rad = 0.0;  ///< elevations of the first and last row
    double period_s = 0.1;                   ///< of one scan, from left to right at even speed
    double divergence_rad = 0.0;
};

/// Rays of one scan, row 0 the highest; time 0 in the middle of the scan. @throws
/// UsageError as for a SpinningSensor
RayTable make_rays(const ScanningWindow& window);

/// What makes the rays of a sensor: one of the kinds of the table in
/// src/log/sensor/pattern_kinds.cpp.
using SensorPattern = std::variant<SpinningSensor, ScanningWindow, Rosette, RayTable>;

/// Rays of the scan at a time. @throws UsageError as make_rays() of the kind it holds
RayTable make_rays(const SensorPattern& pattern, double time_s);

/// A sweep at even speed over columns of rays, each fired together.
struct AzimuthSweep {
    double first_rad, last_rad;  ///< azimuths of the first and last column
    int columns;
};

/// What is known of a pattern without making its rays.
struct PatternSummary {
    std::size_t n_rays = 0;         ///< of a scan
    double period_s = 0.0;          ///< time of one scan; 0: it follows from the time offsets of the rays
    bool has_rays_by_time = false;  ///< scans at different times have different rays
    std::optional<AzimuthSweep> sweep = {};  ///< unless it spins or fires in another order
};
/// The summary of a pattern, from the row of its kind.
PatternSummary describe_pattern(const SensorPattern& pattern);
/// PatternSummary::period_s.
double period_of(const SensorPattern& pattern);

/// A sensor to simulate: what makes its rays, and between which ranges they see.
struct SensorModel {
    std::string name;
    std::string about = {};  ///< what it is and where its figures are from, one line; empty for a file
    RangeLimits limits = {};
    SensorPattern pattern;
};

/// Rays of the scan at a time. @throws UsageError as make_rays() of the pattern
RayTable make_rays(const SensorModel& sensor, double time_s = 0.0);

/// The pattern of a sensor that does not spin; nothing for one that spins.
std::optional<SensorPattern> fixed_pattern(const SensorModel& sensor);

/// Names known_sensor() knows.
std::vector<std::string> sensor_names();
/// A built-in sensor by name ("VLP-16", "kitti360" ..., in any case), where one has it.
/// @param columns @param rate_hz  of a spinning sensor, instead of its usual ones; 0:
/// these
/// @throws UsageError for a number of columns or a rate that a sensor which does not spin
/// cannot have
std::optional<SensorModel> known_sensor(const std::string& name, int columns = 0, double rate_hz = 0.0);

/// A beam table, CSV: a header line, then a line for each beam from the highest down;
/// lines that begin with # are left out. Columns, in any order, those left out 0:
/// elevation_deg (needed), azimuth_offset_deg, origin_offset_m, origin_up_m,
/// origin_left_m as in Beam; firing_offset_us, by how much a beam fires after the head
/// was at its azimuth, which turns it on; min_range_m, max_range_m of the sensor;
/// channel, the maker's number, which is not used.
/// @param where  what messages call it @param columns @param rate_hz  of the sweep
/// @throws DataError naming the line and the value that is wrong
SpinningSensor parse_beam_table(const std::string& text, const std::string& where, int columns,
                                double rate_hz);

/// A grid by name ("kitti360", in any case). @throws UsageError for an unknown name
RangeGrid find_grid(const std::string& name);

}  // namespace relidar
