// SPDX-License-Identifier: Apache-2.0
// Files other tools open. Every writer writes to a temporary name and renames, so no partial file ever has a final name.
#pragma once

#include <cstdint>
#include <filesystem>
#include <functional>
#include <map>
#include <optional>
#include <string>
#include <string_view>
#include <utility>
#include <vector>

#include <glm/glm.hpp>

#include <relidar/channels.hpp>
#include <relidar/math.hpp>
#include <relidar/metrics.hpp>

namespace relidar {

struct PoseTrack;
struct Scene;
struct Surfels;
enum class Primitive;

/// Writes a file by calling `write` on a temporary path beside it, flushing to disk and renaming.
/// The folder must exist. A link is followed; a target that is no regular file (a folder, /dev/null) is refused.
/// @throws DataError where the folder cannot be written or the disk is full; the temporary file is removed. A DataError or
/// standard exception of `write` comes out as a DataError naming the path, other relidar errors as they are.
void write_atomically(const std::filesystem::path& path, const std::function<void(const std::filesystem::path&)>& write);
/// A name beside a file, for what becomes that file once it is complete; never the same twice. remove_temporaries() knows it.
std::filesystem::path temporary_path(const std::filesystem::path& path);
/// Removes what a killed process has left in a folder: files and folders named .NAME.tmp-PID-COUNT. Use it only for a folder that no
/// other process writes to.
void remove_temporaries(const std::filesystem::path& folder);
/// Writes a text through write_atomically.
void write_text(const std::filesystem::path& path, const std::string& text);

/// A folder that is filled beside its name and gets it when it is complete; what has the name goes away then. Where finish() is not reached
/// nothing is left; what a killed process left of the same name is removed by the next one.
class StagedFolder {
public:
    /// @throws DataError where the folder cannot be made
    explicit StagedFolder(const std::filesystem::path& wanted);
    ~StagedFolder();
    StagedFolder(const StagedFolder&) = delete;
    StagedFolder& operator=(const StagedFolder&) = delete;

    const std::filesystem::path& path() const { return path_; }     ///< to write into, until it is finished
    const std::filesystem::path& wanted() const { return wanted_; }  ///< its name, absolute
    /// @throws DataError where it cannot be renamed; what had the name stays
    void finish() const;
    /// The same, unless something has the name by now. An empty folder may have it.
    /// @throws DataError if the name is not free, or the folder cannot be renamed
    void finish_new() const;

private:
    std::filesystem::path wanted_, path_;
};

/// An n-dimensional array of an npz or safetensors file, row-major, little-endian.
struct NamedArray {
    std::string name;
    /// numpy's names without byte order: f4 f8 f2, i1 i2 i4 i8, u1 u2 u4 u8, b1; npz alone: S<bytes>, U<letters>
    std::string dtype;
    std::vector<std::size_t> shape;
    std::vector<std::byte> bytes;

    std::size_t count() const;
    /// Values converted to float (b1 as 0 or 1). @throws DataError for text, or where bytes do not fill the shape
    std::vector<float> as_float() const;
    std::vector<double> as_double() const;   ///< the same, for times and large coordinates
};

/// The array of a name; nothing where there is none.
const NamedArray* find_array(const std::vector<NamedArray>& arrays, std::string_view name);

/// Array of float, double, int32 or uint16 values. @throws DataError where n is not the product of shape
NamedArray make_array(std::string name, std::vector<std::size_t> shape, const float* values, std::size_t n);
NamedArray make_array(std::string name, std::vector<std::size_t> shape, const double* values, std::size_t n);
NamedArray make_array(std::string name, std::vector<std::size_t> shape, const std::int32_t* values, std::size_t n);
NamedArray make_array(std::string name, std::vector<std::size_t> shape, const std::uint16_t* values, std::size_t n);
/// Texts as numpy's fixed-length strings (UTF-32 padded with zeros). @param texts  UTF-8 @return [texts]
NamedArray make_text_array(std::string name, const std::vector<std::string>& texts);
/// One text, of shape [].
NamedArray make_text(std::string name, const std::string& text);

/// npz as numpy.savez_compressed writes it; equal arrays make equal files. @throws DataError beyond 4 GiB, as for write_atomically
void write_npz(const std::filesystem::path& path, const std::vector<NamedArray>& arrays);
/// Arrays of an npz file, stored or deflated, row-major and little-endian. @throws DataError for anything else, or damage
std::vector<NamedArray> read_npz(const std::filesystem::path& path);
/// The array of a .npy file, named after it. @throws DataError as read_npz
NamedArray read_npy(const std::filesystem::path& path);
/// safetensors, arrays in the given order. @throws DataError for names used twice or not UTF-8, as for write_atomically
void write_safetensors(const std::filesystem::path& path, const std::vector<NamedArray>& arrays,
                       const std::map<std::string, std::string>& metadata);
/// Arrays in the order of their data. Whether values are finite is not checked. @throws DataError for a file that is damaged
std::vector<NamedArray> read_safetensors(const std::filesystem::path& path, std::map<std::string, std::string>* metadata = nullptr);

/// Weights of LPIPS: arrays conv{0..4}.weight, conv{0..4}.bias, lin{0..4}.weight of a safetensors file, half or single precision.
/// @throws DataError for a file that is damaged or lacks one; Lpips checks their sizes
LpipsWeights read_lpips_weights(const std::filesystem::path& path);

/// What a file says of itself: names and values, for people and for tools that look for a name.
using FileNotes = std::vector<std::pair<std::string, std::string>>;

/// A point cloud. Fields that a cloud does not have are left out of its files; one that it has is there without a point too.
struct PointCloud {
    std::vector<glm::vec3> position_m;                        ///< [n]
    std::vector<float> intensity;                             ///< [n] 0..1
    std::optional<std::vector<std::uint16_t>> ring = {};      ///< [n] number of the beam, 0 = highest
    std::optional<std::vector<float>> time = {};              ///< [n] seconds from the scan's reference time
    std::optional<std::vector<std::int32_t>> instance = {};   ///< [n] whose surface, index into Scene::instances
    std::optional<std::vector<std::uint8_t>> return_number = {};   ///< [n] of its ray, from 1
    std::vector<ScanChannel> channels = {};                   ///< [n] each
    Pose world_from_points = {};                              ///< takes the points to the world: VIEWPOINT of a PCD
    FileNotes notes = {};                                     ///< comments of PLY and PCD
};
/// Point cloud files: x y z intensity (float32), ring (uint16), time (float32), instance (int32), return (uint8),
/// then the channels (float32 or int32; NAME_x NAME_y NAME_z of vectors, of the channel "normal" in PLY nx ny nz, as readers know them).
/// @throws DataError where lengths differ, as check_channels(), as for write_atomically
void write_ply(const std::filesystem::path& path, const PointCloud& cloud);         ///< binary little-endian
void write_pcd(const std::filesystem::path& path, const PointCloud& cloud);         ///< PCD 0.7, binary
void write_kitti_bin(const std::filesystem::path& path, const PointCloud& cloud);   ///< n x float32 x y z intensity

/// All surfels of a scene as PLY in the layout of 3D Gaussian splatting, every property a little-endian float:
///   x y z, nx ny nz (the surfel's normal), f_dc_0..2, f_rest_0..44 (intensity in all three colours: value = 0.5 + basis . coefficients,
///   f_rest_{15 c + k - 1} = coefficient k of colour c), opacity (logit), scale_0..2 (ln metres; the third, across a surfel, ln 1e-4),
///   rot_0..3 (w x y z), then what the layout has no place for: hit_0..15 and drop_0..15 (coefficients of the two logits), model (index).
/// Positions are in the frame of each surfel's model: actors stand at the origin. @throws DataError as for write_atomically
void write_surfel_ply(const std::filesystem::path& path, const Scene& scene);
/// The same of surfels that are in one frame, as freeze() makes them: without `model`, so that nobody takes them for a scene that can be
/// read back. @param notes  comments
void write_surfel_ply(const std::filesystem::path& path, const Surfels& surfels, const FileNotes& notes);
/// Reads it back: bit-equal surfels, grouped by model, with the models, instances and sensor-level ray-drop of `layout`.
/// Properties may come in any order and others may be there; nx ny nz, scale_2 of surfels and the second and third colour are not read.
/// @param primitive  of the surfels in the file; not given: surfels
/// @throws DataError for text or big-endian files, missing properties, sizes that do not match, values that are not finite
Scene read_surfel_ply(const std::filesystem::path& path, const Scene& layout, Primitive primitive = {});

/// Poses as the CSV that read_trajectory() reads, time_s,x,y,z,yaw_deg,pitch_deg,roll_deg, every number with all its digits: for planners,
/// and to begin a trajectory of one's own from a log's. @throws DataError as for write_atomically
void write_trajectory(const std::filesystem::path& path, const PoseTrack& track);

/// Float channels of one image, ZIP compressed. @param channels name -> [rows*columns] @param notes string attributes
void write_exr(const std::filesystem::path& path, int rows, int columns, const std::map<std::string, std::vector<float>>& channels,
               const FileNotes& notes = {});
/// Channels of one image.
struct ExrImage {
    int rows = 0;
    int columns = 0;
    std::map<std::string, std::vector<float>> channels;   ///< name -> [rows*columns]
    std::map<std::string, std::string> notes;             ///< string attributes
};
/// Every channel of an OpenEXR image of scan lines, whatever its compression and type of numbers. Sizes are checked against the file before
/// anything is allocated. @throws DataError for tiles, deep or several images, subsampled channels, absurd sizes, damage
ExrImage read_exr(const std::filesystem::path& path);

/// 8-bit RGB image.
struct Image {
    int rows = 0;
    int columns = 0;
    std::vector<std::uint8_t> rgb;   ///< [rows*columns*3]
};
/// Colour map of a scalar image: "turbo" (range), "gray" (intensity, drop), "heat" (error). Values outside [low, high] clamp;
/// NaN and pixels with mask 0 are dark gray. @param mask [rows*columns] or empty
/// @throws UsageError for an unknown map, DataError for wrong counts or limits that are not finite
Image colour_map(const std::vector<float>& values, int rows, int columns, float low, float high, const std::string& map,
                 const std::vector<float>& mask = {});
/// Stacks images of one width, separated by a thin line, each enlarged vertically by `stretch` (a LiDAR row is taller than
/// its column is wide). @throws DataError where widths differ
Image stack(const std::vector<Image>& images, int stretch = 1);
/// PNG file, or its bytes. @param notes as international text (iTXt), names of 1 to 79 Latin letters
/// @throws DataError where rgb is not rows*columns*3 bytes, or nothing
void write_png(const std::filesystem::path& path, const Image& image, const FileNotes& notes = {});
std::vector<std::uint8_t> encode_png(const Image& image, const FileNotes& notes = {});

/// One picture row of the report: real, rendered, error.
struct ReportFigure {
    std::string title;
    std::vector<std::pair<std::string, Image>> images;   ///< caption, picture
};
struct ReportCurve {
    std::string name;   ///< curves whose names share the part before '/' ("loss/total", "loss/depth") share a chart
    std::vector<double> x, y;
};
/// Points of a scan in a view of the report.
struct ReportCloud {
    std::string name;                    ///< "real"
    std::vector<glm::vec3> position_m;   ///< [n] about the sensor: x forward, y left, z up; those beyond 300 m are left out
    std::vector<float> intensity;        ///< [n] 0..1
    std::vector<float> error_m;          ///< [n] of the range, NaN where it is not known
};
/// Clouds side by side that the reader turns together. Of large ones every n-th point is kept, so that a page has at most 8 MB.
struct ReportView {
    std::string title;
    std::vector<ReportCloud> clouds;
};
/// How something is spread over bands: a row a class, all its shares together 1.
struct ReportBars {
    struct Row {
        std::string name;            ///< "0 to 10 m"
        double count = 0.0;          ///< of what the shares are of; a row without is left out
        std::vector<double> share;   ///< [bands] 0..1
    };
    std::string title;
    std::string note;                ///< one line
    std::vector<std::string> bands;  ///< at most 5, from good to bad
    std::vector<Row> rows;
};
/// A metric that matters most, as a person calls it.
struct ReportKeyMetric {
    std::string metric;   ///< "strict/depth_medae_m"
    std::string name;     ///< "Typical range error, m"
    std::string hint;     ///< one line: what it says
};
/// A self-contained HTML page: no file or network beside it. First what a person wants to see: summary, views, figures, curves, bars, key
/// metrics; everything else is folded. It holds script where there are views, and only then.
struct Report {
    std::string title;
    std::string summary;                                              ///< one sentence: what, how good, how long
    std::vector<ReportView> views;
    std::vector<ReportBars> bars;
    std::vector<ReportKeyMetric> key_metrics;                         ///< those that no column of metrics has are left out
    std::vector<std::pair<std::string, std::string>> facts;           ///< device, sizes, times
    std::vector<ReportCurve> curves;                                  ///< log scale where positive and spanning more than 4x
    bool same_scans = true;   ///< the columns of metrics are scores of the same scans; false: none is better than another
    std::vector<std::pair<std::string, MetricRow>> metrics;           ///< column title -> values, grouped by the part before '/'
    std::vector<std::pair<std::string, MetricRow>> timings_ms;        ///< table title -> kernel -> ms; shares of "total" or the sum
    std::vector<ReportFigure> figures;
};
/// Writes the page. @throws DataError where x and y of a curve differ in length, as for write_atomically
void write_report(const std::filesystem::path& path, const Report& report);

}  // namespace relidar
