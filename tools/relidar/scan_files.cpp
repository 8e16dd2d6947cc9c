// SPDX-License-Identifier: Apache-2.0
#include "scan_files.hpp"

#include <algorithm>

#include <fmt/format.h>

#include "options.hpp"
#include "pictures.hpp"
#include <relidar/error.hpp>
#include <relidar/export.hpp>
#include <relidar/render.hpp>

namespace relidar::cli {
namespace {

namespace fs = std::filesystem;

constexpr float kDropThreshold = 0.5f;
using Names = std::vector<std::string>;   // of the instances

template <class T>
NamedArray image_array(const char* name, const RangeImage& image, const std::vector<T>& values) {
    return make_array(name, {static_cast<std::size_t>(image.rows), static_cast<std::size_t>(image.columns)}, values.data(), values.size());
}

NamedArray vector_array(const char* name, const RangeImage& image, const std::vector<glm::vec3>& values) {
    const float* first = values.empty() ? nullptr : &values.front().x;
    return make_array(name, {static_cast<std::size_t>(image.rows), static_cast<std::size_t>(image.columns), 3}, first, values.size() * 3);
}

void npz(const fs::path& path, const RenderedScan& scan, const Names& names) {
    const RangeImage& image = scan.image;
    const glm::dmat4 columns = to_matrix(scan.world_from_sensor);
    std::vector<double> pose;   // row-major
    for (int row = 0; row < 4; ++row) {
        for (int column = 0; column < 4; ++column) pose.push_back(columns[column][row]);
    }
    write_npz(path, {image_array("range", image, image.range_m), image_array("median_range", image, scan.median_range_m), image_array("intensity", image, image.intensity),
                     image_array("drop_prob", image, image.drop_prob), image_array("weight", image, scan.weight), image_array("instance", image, scan.instance), make_text_array("instance_names", names), vector_array("directions", image, image.direction),
                     vector_array("origin", image, image.origin), make_array("pose", {4, 4}, pose.data(), pose.size()), make_array("time_s", {}, &scan.time_s, 1)});
}

void exr(const fs::path& path, const RenderedScan& scan, const Names&) {
    const RangeImage& image = scan.image;
    write_exr(path, image.rows, image.columns,
              {{"range", image.range_m}, {"median_range", scan.median_range_m}, {"intensity", image.intensity}, {"drop_prob", image.drop_prob}, {"weight", scan.weight}});
}

PointCloud cloud_of(const RenderedScan& scan) {
    const RangeImage& image = scan.image;
    const std::size_t n = image.range_m.size();
    PointCloud cloud;
    for (std::size_t i = 0; i < n; ++i) {
        if (!(image.drop_prob[i] < kDropThreshold) || !(image.range_m[i] > 0.0f)) continue;
        cloud.position_m.push_back(image.origin[i] + image.range_m[i] * image.direction[i]);
        cloud.intensity.push_back(image.intensity[i]);
        if (scan.channel.size() == n) cloud.channel.push_back(scan.channel[i]);
        if (scan.time_offset_s.size() == n) cloud.time_offset_s.push_back(scan.time_offset_s[i]);
        cloud.instance.push_back(scan.instance[i]);
    }
    return cloud;
}

void ply(const fs::path& path, const RenderedScan& scan, const Names&) { write_ply(path, cloud_of(scan)); }
void pcd(const fs::path& path, const RenderedScan& scan, const Names&) { write_pcd(path, cloud_of(scan)); }
void bin(const fs::path& path, const RenderedScan& scan, const Names&) { write_kitti_bin(path, cloud_of(scan)); }
void png(const fs::path& path, const RenderedScan& scan, const Names&) { write_png(path, scan_picture(scan)); }

struct Format {
    const char* name;   ///< and extension
    void (*write)(const fs::path&, const RenderedScan&, const Names&);
};
constexpr Format kFormats[] = {{"npz", npz}, {"exr", exr}, {"ply", ply}, {"pcd", pcd}, {"bin", bin}, {"png", png}};

}  // namespace

std::vector<std::string> instance_names(const Scene& scene) {
    std::vector<std::string> names;
    for (const Instance& instance : scene.instances) names.push_back(instance.track.empty() ? "background" : instance.track);
    return names;
}

std::vector<std::string> parse_formats(const std::string& list) {
    std::vector<std::string> known, wanted = split(list, ',');
    for (const Format& format : kFormats) known.emplace_back(format.name);
    for (const std::string& name : wanted) {
        if (std::find(known.begin(), known.end(), name) != known.end()) continue;
        throw UsageError(fmt::format("--format: found \"{}\", did you mean {}? (known: {})", name, nearest_name(name, known), fmt::join(known, ", ")));
    }
    return wanted;
}

void write_scan(const fs::path& folder, int frame, const RenderedScan& scan, const ScanFormat& wanted) {
    for (const Format& format : kFormats) {
        if (std::find(wanted.formats.begin(), wanted.formats.end(), format.name) == wanted.formats.end()) continue;
        format.write(folder / fmt::format("frame_{:06}.{}", frame, format.name), scan, wanted.instance_names);
    }
}

}  // namespace relidar::cli
