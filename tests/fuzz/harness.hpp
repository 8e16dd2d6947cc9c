// SPDX-License-Identifier: Apache-2.0
// A libFuzzer harness: a function that reads an input, and one that returns seeds. Seeds
// of formats that never change are stored in corpus.tar.xz instead (seeds/NAME).
#pragma once

#include <filesystem>
#include <string>
#include <string_view>
#include <vector>

namespace relidar::fuzz {

struct Harness {
    const char* name;
    /// Null if all seeds are stored.
    /// @param folder folder in which the writers of the program create files
    std::vector<std::string> (*seeds)(const std::filesystem::path& folder);
    /// May only throw a relidar::Error of usage or data, with a short message.
    void (*read)(std::string_view input, const std::filesystem::path& folder);
    bool seeds_are_good = true;  ///< true if all seeds can be read without an error
};

std::vector<Harness> list_text_harnesses();
std::vector<Harness> list_drive_harnesses();
std::vector<Harness> list_dataset_harnesses();
std::vector<Harness> list_binary_harnesses();
std::vector<Harness> list_request_harnesses();
#ifdef RELIDAR_FUZZ_BAGS
std::vector<Harness> list_bag_harnesses();
#else
inline std::vector<Harness> list_bag_harnesses() { return {}; }
#endif

void put(const std::filesystem::path& file, std::string_view bytes);
std::string read_contents(const std::filesystem::path& file);

/// Returns a single seed, which `Write` writes to a file.
template <auto Write>
std::vector<std::string> written(const std::filesystem::path& folder) {
    Write(folder / "seed");
    return {read_contents(folder / "seed")};
}

template <auto Read>
void read_as_file(std::string_view input, const std::filesystem::path& folder) {
    put(folder / "input", input);
    Read(folder / "input");
}

}  // namespace relidar::fuzz
