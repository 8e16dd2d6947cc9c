// SPDX-License-Identifier: Apache-2.0
#include "run/files/sweeps_file.hpp"

#include <charconv>
#include <cmath>

#include "run/files/file_format.hpp"

namespace relidar::files {
namespace {

constexpr const char* kSweepsFormat = "relidar sweeps";
constexpr const char* kSweepsVersion = "1";

Frame& find_frame(const std::string& array_name, Log& sequence, const std::string& file_name) {
    std::size_t position = sequence.frames.size();
    const auto [end, error] =
        std::from_chars(array_name.data(), array_name.data() + array_name.size(), position);
    if (error != std::errc{} || end != array_name.data() + array_name.size() ||
        position >= sequence.frames.size())
        fail(
            "{}: the array name \"{}\" is not the position of a frame in the log, counted from 0; expected a "
            "number below {}",
            file_name, array_name, sequence.frames.size());
    return sequence.frames[position];
}

}  // namespace

void save_azimuths(const std::filesystem::path& path, const Log& sequence) {
    std::vector<NamedArray> arrays;
    for (std::size_t i = 0; i < sequence.frames.size(); ++i) {
        const std::vector<float>& shift_rad = sequence.frames[i].azimuth_shift_rad;
        if (shift_rad.empty()) continue;
        arrays.push_back(make_vector_array(fmt::format("{:06}", i), shift_rad));
    }
    // Removes the file of an earlier save.
    if (arrays.empty()) return void(std::filesystem::remove(path));
    write_array_file(path, arrays, kSweepsFormat, kSweepsVersion);
}

void load_azimuths(const std::filesystem::path& path, Log& sequence) {
    const ArrayFile file(path, kSweepsFormat, kSweepsVersion);
    for (const NamedArray& array : file.arrays) {
        Frame& frame = find_frame(array.name, sequence, file.path);
        const auto columns = std::size_t(sequence.lidar_of(frame).sensor.columns);
        frame.azimuth_shift_rad = file.find(array.name, "f4", {columns}).to_floats();
        for (const float shift : frame.azimuth_shift_rad)
            if (!(std::abs(shift) <= float(kPi)))
                fail("{}: array {}: found {}, expected radians from -pi to pi", file.path, array.name, shift);
    }
}

}  // namespace relidar::files
