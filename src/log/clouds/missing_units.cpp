// SPDX-License-Identifier: Apache-2.0
#include "log/clouds/missing_units.hpp"

#include <algorithm>
#include <iterator>

#include <relidar/base/arrays.hpp>
#include <relidar/base/error.hpp>

#include "log/clouds/folder_points.hpp"
#include "log/clouds/point_meaning.hpp"
#include "log/clouds/scan_npz.hpp"

namespace relidar::folder {
namespace {

namespace fs = std::filesystem;

/// Reads the points of a few files, evenly spread over the log. Skips unreadable files.
/// Their errors are reported when all scans are read.
std::vector<PointTable> read_sample_tables(const std::vector<fs::path>& scan_files,
                                           const std::vector<std::string>& column_names) {
    std::vector<fs::path> with_points;
    std::ranges::copy_if(scan_files, std::back_inserter(with_points), is_point_file);
    std::vector<PointTable> samples;
    const std::size_t n = std::min(kSampleScans, with_points.size());
    for (std::size_t k = 0; k < n; ++k) {
        try {
            samples.push_back(read_point_file(with_points[k * with_points.size() / n], column_names));
        } catch (const DataError&) {
            continue;
        }
    }
    return samples;
}

/// Estimates the intensity scale of a log from a few of its .npz files.
IntensityScale estimate_image_intensity_scale(const std::vector<fs::path>& scan_files) {
    std::vector<fs::path> images;
    std::ranges::copy_if(scan_files, std::back_inserter(images),
                         [](const fs::path& file) { return file.extension() == ".npz"; });
    std::vector<double> intensities;
    const std::size_t n = std::min(kSampleScans, images.size());
    for (std::size_t k = 0; k < n; ++k) {
        try {
            const std::vector<NamedArray> arrays = read_npz(images[k * images.size() / n]);
            if (const NamedArray* array = find_array(arrays, "intensity"))
                std::ranges::copy(array->convert_to_doubles(), std::back_inserter(intensities));
        } catch (const DataError&) {
            continue;  // the error is reported when the scan is read
        }
    }
    return estimate_intensity_scale(intensities);
}

}  // namespace

void estimate_missing_point_units(SequenceHeader& sequence_header, const std::vector<fs::path>& scan_files,
                                  std::vector<std::string>& notes) {
    const std::vector<PointTable> samples = read_sample_tables(scan_files, sequence_header.units.columns);
    PointFieldSemantics meaning = interpret_point_fields(samples);
    if (samples.empty() && !sequence_header.units.intensity_max)
        meaning.scale = estimate_image_intensity_scale(scan_files);
    sequence_header.units.intensity_field = meaning.intensity_field;
    sequence_header.units.no_return = meaning.no_return;
    std::erase(meaning.notes, meaning.scale.about);
    if (!sequence_header.units.intensity_max && meaning.scale.is_sure && meaning.scale.max > 1.0) {
        sequence_header.units.intensity_max = meaning.scale.max;
        notes.push_back(meaning.scale.about +
                        "; set the key \"intensity_max\" in sequence.json to use another scale");
    }
    notes.insert(notes.end(), meaning.notes.begin(), meaning.notes.end());
}

}  // namespace relidar::folder
