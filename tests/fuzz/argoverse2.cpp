// SPDX-License-Identifier: Apache-2.0
// Fuzzes Feather files, and a small Argoverse 2 log in which the input replaces a file.
#include "harness.hpp"

#include <cstdlib>

#include "base/codecs/feather.hpp"
#include "changed_files.hpp"
#include "read/datasets/argoverse2/argoverse2_log.hpp"

namespace relidar::fuzz {
namespace {

namespace fs = std::filesystem;

std::vector<std::string> make_feather_seeds(const fs::path&) {
    const std::vector<std::int64_t> times{315966265259836000, 7, -1};
    std::vector<std::string> seeds;
    for (const test::FeatherCodec codec :
         {test::FeatherCodec::none, test::FeatherCodec::lz4, test::FeatherCodec::zstd})
        seeds.push_back(test::make_feather_bytes(
            {test::make_numbers("a", times), test::make_halves("b", {1.0f, -2.0f, 3.0f}),
             test::make_texts("c", {"up_lidar", "", "x"}), test::make_texts("d", {"y", "y", "z"}, true)},
            codec, 2));
    return seeds;
}

void read_feather(std::string_view input, const fs::path&) {
    const Feather table("input", std::string(input));
    std::string failure;
    for (const char* column : {"a", "b", "c", "d"}) {
        for (const int as : {0, 1, 2}) {
            try {
                if (as == 0) table.read_numbers(column);
                if (as == 1) table.read_integers(column);
                if (as == 2) table.read_texts(column);
            } catch (const DataError& error) {
                failure = error.what();  // only the last failure is reported
            }
        }
    }
    if (!failure.empty()) throw DataError(failure);
}

struct Log {
    test::Argoverse2Log log;
    ChangedFiles files;

    explicit Log(const fs::path& folder)
        : log((::setenv("TEST_TMPDIR", folder.c_str(), 1), "fuzz"),
              {.sweeps = 2, .firings = 3, .codec = test::FeatherCodec::none}),
          files({log.sweep(0), log.sweep(1), log.file("annotations.feather"),
                 log.file("city_SE3_egovehicle.feather"),
                 log.file("calibration/egovehicle_SE3_sensor.feather")}) {}
};

const Log& log_in(const fs::path& folder) {
    static const Log log(folder);
    return log;
}

std::vector<std::string> make_log_seeds(const fs::path& folder) {
    return log_in(folder).files.make_seeds_of_one();
}

void read_log(std::string_view input, const fs::path& folder) {
    const Log& log = log_in(folder);
    log.files.read_one(input, [&] { load_sequence("argoverse2:" + log.log.folder.string(), {}); });
}

}  // namespace

std::vector<Harness> list_argoverse2_harnesses() {
    return {{"feather", make_feather_seeds, read_feather, false}, {"argoverse2", make_log_seeds, read_log}};
}

}  // namespace relidar::fuzz
