// SPDX-License-Identifier: Apache-2.0
// Models of LiDAR sensors. Each model generates a table of rays. A range grid defines the
// pixel to which a point belongs. Sensor frame: x forward, y left, z up, metres.
#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <filesystem>
#include <limits>
#include <optional>
#include <span>
#include <string>
#include <string_view>
#include <variant>
#include <vector>

#include <glm/glm.hpp>

namespace relidar {

// Memory for the arrays of rays and scans. A log of 6000 scans needs 30 GB, which is more
// than most machines have. Therefore, arrays beyond a limit are stored in a memory-mapped
// file, and the operating system loads only the pages in use. The file is only slightly
// slower than memory, because scans are written once and then read frame by frame.

/// Limits the memory of scan arrays that are allocated after this call, in this process.
/// Arrays beyond the limit are stored in an unnamed file, which disappears when the
/// process ends. Until this function is called, the memory is unlimited.
/// @param max_bytes  0: half of the memory of the machine or of the control group,
/// divided by the number of processes (share_scan_memory())
/// @param overflow_folder  folder of the file; the file is created when the first array
/// needs it; empty: the system's folder for temporary files
void limit_scan_memory(std::uint64_t max_bytes, std::filesystem::path overflow_folder = {});

/// Sets the number of processes on this machine that load scans. These processes share
/// the memory limit. The default is one process.
void share_scan_memory(int n_processes);

/// Memory used by the arrays of all scans, in bytes. Arrays below 16 KiB are not counted.
struct ScanMemoryUse {
    std::uint64_t in_memory = 0;
    std::uint64_t in_file = 0;
};
/// Returns how many bytes the arrays of all scans use now, in memory and in the file.
ScanMemoryUse scan_memory_use();

/// Allocates an array in memory, or in a mapped file if the memory limit is reached.
/// @throws DataError naming the folder if its disk is full or it cannot be written
/// @throws std::bad_alloc
void* allocate_array(std::size_t bytes);
void free_scan_array(void* array, std::size_t bytes) noexcept;

/// Allocator for the arrays of scans. It stores arrays in a mapped file if the memory
/// limit is reached.
template <class T>
struct ScanAllocator {
    using value_type = T;

    ScanAllocator() = default;
    template <class U>
    ScanAllocator(const ScanAllocator<U>&) {}
    T* allocate(std::size_t count) { return static_cast<T*>(allocate_array(count * sizeof(T))); }
    void deallocate(T* array, std::size_t count) noexcept { free_scan_array(array, count * sizeof(T)); }
    bool operator==(const ScanAllocator&) const { return true; }
};

/// Array with a value for each ray of a scan.
template <class T>
using ScanArray = std::vector<T, ScanAllocator<T>>;

template <class T>
std::vector<T> to_vector(const ScanArray<T>& values) {
    return {values.begin(), values.end()};
}

template <class T>
ScanArray<T> to_scan_array(const std::vector<T>& values) {
    return {values.begin(), values.end()};
}

/// A table of rays in the order of a range image. Ray (row, column) has index row *
/// columns + column. Row 0 is the highest beam. Column 0 is at azimuth +180 degrees, and
/// the azimuth decreases with the column. For a sensor without an image, rows = 1.
struct RayTable {
    int rows = 0;
    int columns = 0;
    ScanArray<glm::vec3> origin;     ///< [rows*columns] start of the ray; metres, sensor frame
    ScanArray<glm::vec3> direction;  ///< [rows*columns] unit vector, sensor frame
    /// [rows*columns] firing time relative to the frame's reference time
    ScanArray<float> time_offset_s;
    ScanArray<std::uint16_t> channel;  ///< [rows*columns] beam number, 0 = highest
    float divergence_rad = 0.0f;       ///< full beam divergence of all rays; 0 = ideal ray
    /// [rows*columns] divergence of each ray. If the array is empty, all rays have the
    /// divergence `divergence_rad`.
    ScanArray<float> ray_divergence_rad = {};

    std::size_t size() const { return direction.size(); }
    double divergence_of_rad(std::size_t ray) const {
        return ray_divergence_rad.empty() ? divergence_rad : ray_divergence_rad[ray];
    }
    /// Returns 0 if all rays are ideal.
    double max_divergence_rad() const;
    /// Appends a ray of another table, always of the same one. Does not change `rows` and
    /// `columns`.
    void append_ray(const RayTable& source_table, std::size_t ray_index);
};
/// Returns the offsets of the sub-rays that sample the footprint of a beam: [count], in
/// units of half the beam divergence. The first sub-ray is the beam axis. All sub-rays
/// have the same weight. The mean of offset^2 is 1/2, which equals the spread of an
/// evenly lit disc.
/// @param n_sub_rays  1, 5 or 9; any other number gives a spiral whose first ray is not
/// on the axis
std::vector<glm::dvec2> spread_sub_rays(int n_sub_rays);
/// Returns true if the columns of a range image cover a full turn, up to a gap of 10
/// degrees. The first column then follows the last column.
/// @param directions [rows*columns] directions of the rays, sensor frame
bool is_full_turn(int rows, int columns, std::span<const glm::vec3> directions);
/// Returns a table without image order (rows = 1).
RayTable select_rays(const RayTable& rays, const std::vector<std::size_t>& ray_indices);

/// A beam of a spinning LiDAR. When the rotating head is at azimuth theta
/// (counter-clockwise), the ray has elevation e = elevation_rad and azimuth a = theta +
/// azimuth_offset_rad. It starts at
///   R_z(theta) * (origin_offset_m, 0, 0)
///   + R_z(a) * (-origin_up_m * sin(e), origin_left_m, origin_up_m * cos(e)).
/// R_z is a rotation about the z axis. The second term is perpendicular to the ray.
struct Beam {
    double elevation_rad = 0.0;
    double azimuth_offset_rad = 0.0;
    double origin_offset_m = 0.0;  ///< offset of the origin along the head direction
    double origin_up_m = 0.0;      ///< offset of the origin perpendicular to the beam, in its vertical plane
    double origin_left_m = 0.0;    ///< offset of the origin to the left of the beam
    double intensity_gain = 1.0;
    double intensity_offset = 0.0;
    double range_offset_m = 0.0;

    /// Range that the beam measures for a surface. The next four functions convert
    /// between the values of a surface and the measured values:
    ///   measured range = range of the surface + range_offset_m,
    ///   measured intensity = intensity_gain * intensity_factor_at_range * intensity of the surface
    ///                        + intensity_offset, clamped to 0..1
    /// A range of 0 (no return) stays 0. Each conversion can be inverted if no value is
    /// clamped.
    /// @param intensity_factor_at_range  factor of the log's IntensityResponse at the
    /// range of the surface
    double to_measured_range_m(double surface_range_m) const;
    double to_surface_range_m(double measured_range_m) const;  ///< at least 1 mm
    double to_measured_intensity(double surface_intensity, double intensity_factor_at_range) const;
    double to_surface_intensity(double measured_intensity, double intensity_factor_at_range) const;
};

/// Returns an ideal beam, which changes neither range nor intensity, if the number is
/// unknown.
const Beam& find_beam(const std::vector<Beam>& beams, std::size_t channel);

/// Range limits of a sensor. A ray whose range is outside the limits is dropped.
struct RangeLimits {
    double min_m = 0.0;
    double max_m = std::numeric_limits<double>::infinity();

    /// Returns false for a range of 0, which means that the ray hit nothing.
    bool contains(double range_m) const { return range_m > 0.0 && range_m >= min_m && range_m <= max_m; }
};
/// @throws UsageError if the intersection contains no range
RangeLimits intersect(const RangeLimits& first, const RangeLimits& second);

/// A spinning LiDAR.
struct SpinningSensor {
    std::string name;
    std::vector<Beam> beams;  ///< beams, highest first
    int columns = 0;          ///< azimuth steps in a sweep
    double period_s = 0.1;    ///< Duration of a sweep. If it is 0, the sensor does not spin.
    bool clockwise = true;    ///< direction of rotation, seen from above
    /// Azimuth of the centre of column 0. With pi - pi/columns, column 0 begins exactly
    /// at azimuth pi.
    double first_azimuth_rad = 0.0;
    /// Azimuths of the first and the last ray of a turn. Between the last and the first,
    /// the head turns without firing. No value: it fires at all azimuths.
    std::optional<std::array<double, 2>> azimuth_rad = {};
    double min_range_m = 0.0;
    double max_range_m = 80.0;
    double divergence_rad = 0.0;

    RangeLimits range_limits() const { return {min_range_m, max_range_m}; }
};

/// Returns the columns of a turn in which a sensor fires, ascending: all `columns`, or
/// those within `azimuth_rad`.
std::vector<int> fired_columns(const SpinningSensor& sensor);

/// Start and direction of a beam in the sensor frame.
struct BeamRay {
    glm::dvec3 origin_m;
    glm::dvec3 direction;
};

/// Uses the equation of `Beam`.
BeamRay aim_beam(const Beam& beam, double head_azimuth_rad);

/// Inverse of aim_beam(): azimuth of the head at which a beam hits a point.
/// @param point_m [3] metres, sensor frame
/// @return radians, not wrapped to a range
double azimuth_facing_rad(const Beam& beam, const glm::dvec3& point_m);

/// Returns a beam's azimuth offset in image columns, rounded. Beams that fire at the same
/// time have different azimuths, but all pixels of an image column have the same azimuth.
/// Therefore column j of the beam's image row shows the beam's firing number (j + offset)
/// mod n_columns, not firing j.
int offset_columns(const Beam& beam, int n_columns);

/// Returns the rays of a sweep. At time 0 the head faces forward (azimuth 0). A head that
/// rotates clockwise reaches azimuth a at time -a / (2 pi) * period.
/// @throws UsageError if the sensor has no beams, no columns, more than kMaxRays rays, a
/// value that is not finite, or an empty range between its limits
RayTable make_rays(const SpinningSensor& sensor);
/// Maximum number of rays in a sweep: 128 beams with azimuth steps of 0.003 degrees. Such
/// a sweep and its scan use 500 MB.
inline constexpr std::size_t kMaxRays = std::size_t(1) << 24;

/// Probability that the sensor itself drops a ray, for each beam and azimuth bin (paper
/// section 3.5). This probability does not depend on the scene. For example, the vehicle
/// that carries the sensor blocks some rays. The total drop probability is P(drop) = 1 -
/// (1 - P of the scene) (1 - P of the sensor).
struct RayDropTable {
    int channels = 0;
    int bins = 0;  ///< Number of azimuth bins. Bin 0 starts at +180 degrees, and the azimuth decreases.
    std::vector<float> probability;  ///< [channels, bins] drop probability

    bool empty() const { return probability.empty(); }
    /// Returns the index of a ray's entry in `probability`.
    /// @param direction [3] sensor frame
    std::size_t index_of(std::uint16_t channel, const glm::vec3& direction) const;
    /// Returns the drop probability of a ray.
    /// @param direction [3] sensor frame
    /// @return 0 if the table is empty or does not have the channel
    float probability_of(std::uint16_t channel, const glm::vec3& direction) const;
};

/// Layout of a range image whose rows have equal elevation steps and whose columns have
/// equal azimuth steps, like the KITTI-360 grid. The centre of pixel (i, j) has, in
/// degrees:
///   elevation = fov_up - i * fov / rows,  azimuth = 180 - j * 360 / columns
struct RangeImageGrid {
    std::string name;
    int rows = 0;
    int columns = 0;
    double fov_up_rad = 0.0;  ///< elevation of row 0
    double fov_rad = 0.0;     ///< total vertical field of view
    double max_range_m = 80.0;
};

/// Returns the range grid that published results on KITTI-360 use: 66 x 1030 pixels,
/// elevation +2.0 to -24.9 degrees, 80 m.
RangeImageGrid kitti360_grid();

/// Returns rays through the pixel centres of a grid. All rays start at the sensor origin.
/// The sweep is clockwise and takes 0.1 s.
RayTable make_rays(const RangeImageGrid& grid);

/// Projects a point into a range grid (sensor model, Eq. 6-7) and returns the nearest
/// pixel.
/// @param point_m [3] metres, sensor frame
/// @return row * columns + column. Nothing if the point is outside the vertical field of
/// view, at range 0 or beyond max_range_m.
/// @differs Eq. 7 as printed divides only |f_down| by f_v; Eq. 6 writes arctan(y, x) and
/// arcsin(z, d).
std::optional<int> project_to_pixel(const RangeImageGrid& grid, const glm::dvec3& point_m);

/// A range image that was made by projecting points onto a grid. If several points fall
/// into the same pixel, the pixel holds the nearest of these points.
struct ProjectedRangeImage {
    int rows = 0;
    int columns = 0;
    std::vector<float> range_m;    ///< [rows*columns] 0 in pixels without a point
    std::vector<float> intensity;  ///< [rows*columns] intensity of the nearest point
    /// [rows*columns] index of the point in the pixel. The index is -1 in pixels without
    /// a point.
    std::vector<int> source;
};

/// Projects points into a range grid.
/// @param points_m [n] metres, sensor frame
/// @param intensity [n] intensity of each point
/// @throws UsageError if the two arrays have different lengths
ProjectedRangeImage project_points(const RangeImageGrid& grid, const std::vector<glm::vec3>& points_m,
                                   const std::vector<float>& intensity);

/// A LiDAR that deflects its beam with two prisms. The prisms rotate in opposite
/// directions. A scan is a flower-shaped pattern (rosette) about the x axis, and each
/// scan covers different directions:
///   direction = (cos r, sin r cos p, sin r sin p)
///   r e^(ip) = deflection (e^(i 2 pi f1 t) + e^(i 2 pi f2 t))
/// This is the paraxial form of two thin prisms with equal wedge angles.
struct RosetteSensor {
    std::string name;
    /// Deflection by each of the two prisms. The scanned cone has a half angle of twice
    /// this value.
    double deflection_rad = 0.0;
    /// Rotation rates of the prisms. A positive rate means counter-clockwise rotation,
    /// seen from behind the sensor.
    double first_hz = 0.0, second_hz = 0.0;
    int n_rays = 0;  ///< rays of a scan, evenly spaced in time
    double period_s = 0.1;
    double divergence_rad = 0.0;
};

/// Returns the rays of the scan at a time, in the order of firing. The table has one row,
/// and all rays have channel 0. Time offsets range from -period/2 to period/2.
/// @throws UsageError for no rays, for more than kMaxRays rays, or for a value that is
/// not finite
RayTable make_rays(const RosetteSensor& rosette, double time_s);

/// A LiDAR that scans a rectangular window with mirrors. Its rows have evenly spaced
/// elevations, and its columns have evenly spaced azimuths. All rows of a column fire at
/// the same time.
struct WindowScanSensor {
    std::string name;
    int rows = 0, columns = 0;
    /// azimuths of the first and last column, positive to the left
    double left_rad = 0.0, right_rad = 0.0;
    double top_rad = 0.0, bottom_rad = 0.0;  ///< elevations of the first and last row
    double period_s = 0.1;                   ///< duration of a scan, from left to right at constant speed
    double divergence_rad = 0.0;
};

/// Returns the rays of a scan. Row 0 is the highest row. Time 0 is the middle of the
/// scan.
/// @throws UsageError if there are no rays, more than kMaxRays rays or more than 65535
/// rows, if an angle is not finite, or if the period is not a positive number
RayTable make_rays(const WindowScanSensor& window);

/// Scan pattern of a sensor: the parameters from which its rays are generated.
/// docs/architecture.md lists the kinds of patterns in a table.
using SensorPattern = std::variant<SpinningSensor, WindowScanSensor, RosetteSensor, RayTable>;

/// @throws UsageError if a value of the pattern is invalid
RayTable make_rays(const SensorPattern& pattern, double time_s);

/// A sweep at constant speed over columns of rays. All rays of a column fire at the same
/// time.
struct AzimuthSweep {
    double first_rad, last_rad;  ///< azimuths of the first and last column
    int columns;
};

/// Properties of a scan pattern that are known without generating its rays.
struct ScanPatternSummary {
    std::size_t n_rays = 0;  ///< number of rays in a scan
    /// duration of a scan; 0 if the pattern only stores the time offsets of its rays
    double period_s = 0.0;
    bool has_rays_by_time = false;  ///< True if scans at different times have different rays.
    /// set only for a sensor that does not spin and fires column by column
    std::optional<AzimuthSweep> sweep = {};
};
/// Returns the number of rays, the duration and the sweep of a scan pattern.
ScanPatternSummary summarise_pattern(const SensorPattern& pattern);
/// Returns ScanPatternSummary::period_s.
double scan_period_s(const SensorPattern& pattern);

/// A sensor to simulate: its scan pattern and its range limits.
struct SensorModel {
    std::string name;
    /// One line that names the source of the specification. Empty for a sensor file.
    std::string about = {};
    RangeLimits limits = {};
    SensorPattern pattern;
};

/// Returns the rays of a sensor's scan at a time, in the order of firing.
/// @throws UsageError as make_rays() of the pattern
RayTable make_rays(const SensorModel& sensor, double time_s = 0.0);

/// Returns the scan pattern of a sensor that does not spin, or nothing for a spinning
/// sensor.
std::optional<SensorPattern> other_pattern(const SensorModel& sensor);

/// Returns the names that find_built_in() accepts.
std::vector<std::string> list_sensors();
/// Returns the built-in sensor with this name, or nothing if no sensor has this name.
/// @param name  for example "VLP-16" or "kitti360", in upper or lower case
/// @param columns,rate_hz  azimuth steps and rotation rate of a spinning sensor; 0: the
/// defaults of the sensor
/// @throws UsageError if one of them is set for a sensor that does not spin
std::optional<SensorModel> find_built_in(const std::string& name, int columns = 0, double rate_hz = 0.0);

/// Parses a table of beams in CSV format: a header line, then a line for each beam, from
/// the highest to the lowest. Lines that begin with # are ignored. The columns can have
/// any order. The values of a missing column are 0:
/// - elevation_deg (required), azimuth_offset_deg, origin_offset_m, origin_up_m,
///   origin_left_m: as in Beam;
/// - firing_offset_us: delay of the beam's firing after the head was at its azimuth; the
///   head turns during this delay;
/// - min_range_m, max_range_m: limits of the sensor;
/// - channel: the manufacturer's channel number, which is ignored.
/// @param n_columns  azimuth steps in a sweep
/// @throws DataError naming the line and the value that is wrong
SpinningSensor parse_beams(const std::string& text, const std::string& where, int n_columns, double rate_hz);

/// Returns a range grid by name, for example "kitti360", in upper or lower case.
/// @throws UsageError for an unknown name
RangeImageGrid find_grid(const std::string& name);

}  // namespace relidar
