// SPDX-License-Identifier: Apache-2.0
// Fuzzes a small nuScenes folder in which the input replaces a file.
#include "harness.hpp"

#include <cstdlib>

#include "changed_files.hpp"
#include "read/datasets/nuscenes/nuscenes_folder.hpp"

namespace relidar::fuzz {
namespace {

namespace fs = std::filesystem;

struct Folder {
    test::NuscenesFolder data;
    ChangedFiles files;

    explicit Folder(const fs::path& at)
        : data((::setenv("TEST_TMPDIR", at.c_str(), 1), "fuzz"), 6), files(changed(data)) {}

    static std::vector<fs::path> changed(const test::NuscenesFolder& data) {
        std::vector<fs::path> files;
        for (const char* table : {"scene", "sample", "sensor", "calibrated_sensor", "sample_data", "ego_pose",
                                  "sample_annotation", "instance", "category"})
            files.push_back(data.table(table));
        files.push_back(data.sweep(0));
        files.push_back(data.sweep(4));
        return files;
    }
};

const Folder& make_folder_in(const fs::path& scratch) {
    static const Folder folder(scratch);
    return folder;
}

std::vector<std::string> make_seeds(const fs::path& scratch) {
    return make_folder_in(scratch).files.make_seeds_of_one();
}

void read(std::string_view input, const fs::path& scratch) {
    const Folder& folder = make_folder_in(scratch);
    folder.files.read_one(
        input, [&] { load_sequence("nuscenes:" + folder.data.folder.string(), {.sequence = "scene-0103"}); });
}

}  // namespace

std::vector<Harness> list_nuscenes_harnesses() { return {{"nuscenes", make_seeds, read}}; }

}  // namespace relidar::fuzz
