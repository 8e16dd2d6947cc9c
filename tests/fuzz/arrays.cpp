// SPDX-License-Identifier: Apache-2.0
// Fuzzes binary files: arrays, models, checkpoints, surfels and weights.
#include "harness.hpp"

#include <relidar/base/arrays.hpp>
#include <relidar/run/checkpoint.hpp>
#include <relidar/scene/surfel_ply.hpp>
#include <relidar/score/metrics.hpp>

#include "base/codecs/npy.hpp"
#include "run/files/example_run.hpp"

namespace relidar::fuzz {
namespace {

namespace fs = std::filesystem;

std::vector<NamedArray> make_example_arrays() {
    const float values[6] = {1.0f, -2.0f, 0.5f, 1e-20f, 3e38f, 0.0f};
    const std::int32_t counts[3] = {1, 2, -3};
    return {make_array("a", {2, 3}, values, 6), make_array("count", {3}, counts, 3),
            make_array("none", {0, 4}, values, 0), make_text_array("names", {"background", "mover-1"})};
}

Scene make_small_scene() { return wrap_background(make_example_surfels(3)); }

std::vector<std::string> make_npy_seeds(const fs::path&) {
    std::vector<std::string> seeds;
    for (const NamedArray& array : make_example_arrays())
        seeds.push_back(codecs::make_npy_header(array) +
                        std::string(reinterpret_cast<const char*>(array.bytes.data()), array.bytes.size()));
    return seeds;
}

std::vector<NamedArray> make_number_arrays() {
    std::vector<NamedArray> arrays = make_example_arrays();
    arrays.pop_back();
    return arrays;
}

void write_small_safetensors(const fs::path& file) {
    write_safetensors(file, make_number_arrays(), {{"k", "v"}});
}

}  // namespace

std::vector<Harness> list_array_harnesses() {
    return {
        {"npz", written<[](const fs::path& file) { write_npz(file, make_example_arrays()); }>,
         read_as_file<[](const fs::path& file) { read_npz(file); }>},
        {"npy", make_npy_seeds,
         [](std::string_view input, const fs::path&) { codecs::parse_npy("a", input); }},
        {"safetensors", written<write_small_safetensors>,
         read_as_file<[](const fs::path& file) { read_safetensors(file); }>},
        {"model", written<[](const fs::path& file) { save_model(file, make_small_scene()); }>,
         read_as_file<[](const fs::path& file) { load_model(file); }>},
        {"checkpoint", written<[](const fs::path& file) {
             write_checkpoint(file, {7, {{"seed", "1"}, {"config", "x = 1"}}, make_number_arrays()});
         }>,
         read_as_file<[](const fs::path& file) { read_checkpoint(file); }>},
        {"ply", written<[](const fs::path& file) { write_surfels(file, make_small_scene()); }>,
         read_as_file<[](const fs::path& file) { read_surfel_ply(file, make_small_scene()); }>},
        // complete weights would have 10 MB
        {"lpips", written<write_small_safetensors>,
         read_as_file<[](const fs::path& file) { Lpips{read_lpips_weights(file)}; }>, false},
    };
}

}  // namespace relidar::fuzz
