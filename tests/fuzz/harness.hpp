// SPDX-License-Identifier: Apache-2.0
// Declares a libFuzzer harness of a parser: a function that returns the initial inputs,
// and a function that reads an input.
#pragma once

#include <filesystem>
#include <string>
#include <string_view>
#include <vector>

namespace relidar::fuzz {

struct Harness {
    const char* name;
    /// Returns the initial inputs.
    /// @param folder folder in which the writers of the program create files
    std::vector<std::string> (*seeds)(const std::filesystem::path& folder);
    /// Reads an input. It may only throw a relidar::Error of usage or data, with a
    /// message short enough for a terminal.
    /// @param folder folder that is reused for all inputs
    void (*read)(std::string_view input, const std::filesystem::path& folder);
    bool seeds_are_good = true;  ///< true if all seeds can be read without an error
};

/// Returns the harnesses that a file defines. main.cpp combines them.
std::vector<Harness> array_harnesses();
std::vector<Harness> text_harnesses();
std::vector<Harness> drive_harnesses();
std::vector<Harness> waymo_harnesses();
std::vector<Harness> folder_harnesses();
std::vector<Harness> argoverse2_harnesses();
std::vector<Harness> nuscenes_harnesses();
std::vector<Harness> stamped_harnesses();
std::vector<Harness> sensor_harnesses();
std::vector<Harness> run_harnesses();
std::vector<Harness> request_harnesses();
#ifdef RELIDAR_FUZZ_BAGS
std::vector<Harness> bag_harnesses();
#else
inline std::vector<Harness> bag_harnesses() { return {}; }
#endif

void put(const std::filesystem::path& file, std::string_view bytes);
std::string contents(const std::filesystem::path& file);

}  // namespace relidar::fuzz
