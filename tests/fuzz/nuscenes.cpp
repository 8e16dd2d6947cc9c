// SPDX-License-Identifier: Apache-2.0
// A small nuScenes folder of which an input replaces one file: its first byte says which.
#include "harness.hpp"

#include <cstdlib>

#include <relidar/dataset.hpp>
#include "dataset/nuscenes_folder.hpp"

namespace relidar::fuzz {
namespace {

namespace fs = std::filesystem;

class Folder {
public:
    explicit Folder(const fs::path& folder) : data_((::setenv("TEST_TMPDIR", folder.c_str(), 1), "fuzz"), 6) {
        for (const char* table : {"scene", "sample", "sensor", "calibrated_sensor", "sample_data", "ego_pose", "sample_annotation",
                                  "instance", "category"})
            files_.push_back(data_.table(table));
        files_.push_back(data_.sweep(0));
        files_.push_back(data_.sweep(4));
        for (const fs::path& file : files_) usual_.push_back(contents(file));
    }
    std::size_t size() const { return files_.size(); }
    const std::string& usual(std::size_t file) const { return usual_[file]; }
    void read_with(std::size_t file, std::string_view bytes) const {
        struct Restore {
            const Folder& folder;
            std::size_t file;
            ~Restore() { put(folder.files_[file], folder.usual_[file]); }
        } restore{*this, file};
        put(files_[file], bytes);
        DatasetOptions options;
        options.sequence = "scene-0103";
        load_sequence("nuscenes:" + data_.folder.string(), options);
    }

private:
    test::NuscenesFolder data_;
    std::vector<fs::path> files_;
    std::vector<std::string> usual_;
};

const Folder& folder_in(const fs::path& scratch) {
    static const Folder folder(scratch);
    return folder;
}

std::vector<std::string> seeds_of(const fs::path& scratch) {
    const Folder& folder = folder_in(scratch);
    std::vector<std::string> seeds;
    for (std::size_t file = 0; file < folder.size(); ++file) seeds.push_back(char(file) + folder.usual(file));
    return seeds;
}

void read(std::string_view input, const fs::path& scratch) {
    if (input.empty()) return;
    const Folder& folder = folder_in(scratch);
    folder.read_with(static_cast<unsigned char>(input[0]) % folder.size(), input.substr(1));
}

}  // namespace

std::vector<Harness> nuscenes_harnesses() {
    return {{"nuscenes", seeds_of, read}};
}

}  // namespace relidar::fuzz
