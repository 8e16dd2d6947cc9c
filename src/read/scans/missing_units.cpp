// SPDX-License-Identifier: Apache-2.0
// Estimates units of point values that sequence.json does not contain.

#include <relidar/base/arrays.hpp>

#include "read/files/scan_npz.hpp"
#include "read/scans/folder_points.hpp"
#include "read/scans/point_meaning.hpp"
#include "read/scans/point_times.hpp"

namespace relidar::read {
namespace {

namespace fs = std::filesystem;

/// Reads the points of a few scans. Files of rays have no points and are left out.
std::vector<PointTable> sample_tables(const std::vector<fs::path>& scan_files,
                                      const std::vector<std::string>& column_names) {
    std::vector<fs::path> with_points = scan_files;
    if (!has_npz_points(scan_files))
        std::erase_if(with_points, [](const fs::path& file) { return !is_point_file(file); });
    std::vector<PointTable> samples;
    read_samples(with_points.size(),
                 [&](std::size_t i) { samples.push_back(read_point_file(with_points[i], column_names)); });
    return samples;
}

/// Reads the arrays "intensity" and "time" of a few .npz files with rays.
std::vector<PointTable> sample_images(std::vector<fs::path> files) {
    std::erase_if(files, [](const fs::path& file) { return file.extension() != ".npz"; });
    std::vector<PointTable> samples;
    read_samples(files.size(), [&](std::size_t i) {
        const std::vector<NamedArray> arrays = read_npz(files[i]);
        PointTable& table = samples.emplace_back(arrays.empty() ? 0 : arrays[0].element_count());
        for (const char* name : {"intensity", "time"})
            if (const NamedArray* array = find_array(arrays, name);
                array && array->element_count() == table.n)
                table.add_value_field(name, ScalarType::f8, array->to_doubles(), "");
    });
    return samples;
}

/// Ignores times that have lost their precision, with a note.
void drop_coarse_times(PointFileUnits& units, const std::vector<PointTable>& samples, Notes& notes) {
    constexpr double kTypicalSweep_s = 0.1;
    for (const PointTable& cloud : samples) {
        const auto range = find_time_range(cloud);
        if (!range || units.ignore_times) continue;
        const auto [first, last] = *range;
        const double resolution = time_resolution(cloud),
                     span = last > first ? last - first : kTypicalSweep_s / units.time_unit_s;
        units.ignore_times = is_coarse_time(resolution, span);
        if (units.ignore_times) notes.push_back(describe_coarse(last, resolution));
    }
}

}  // namespace

void fill_units(PointFileUnits& units, const std::vector<fs::path>& scan_files, Notes& notes) {
    std::vector<PointTable> samples = sample_tables(scan_files, units.columns);
    for (PointTable& cloud : samples) unwrap_times(cloud, !units.absolute_times);
    PointFieldSemantics meaning = interpret_fields(samples);
    drop_coarse_times(units, samples, notes);
    if (samples.empty()) {
        // No file of points was read, so units are estimated from range images.
        const std::vector<PointTable> images = sample_images(scan_files);
        drop_coarse_times(units, images, notes);
        std::vector<double> intensities;
        for (const PointTable& image : images)
            if (const PointFieldView* field = image.find_field("intensity"))
                for (std::size_t i = 0; i < image.n; ++i) intensities.push_back((*field)[i]);
        if (!units.intensity_max) meaning.scale = estimate_scale(intensities);
    }
    units.intensity_field = meaning.intensity_field;
    units.no_return = meaning.no_return;
    units.returns = meaning.returns;
    if (!units.intensity_max && meaning.scale.is_sure && meaning.scale.max > 1.0) {
        units.intensity_max = meaning.scale.max;
        notes.push_back(meaning.scale.about +
                        "; set the key \"intensity_max\" in sequence.json to use another scale");
    }
    notes.insert(notes.end(), meaning.notes.begin(), meaning.notes.end());
}

}  // namespace relidar::read
