// SPDX-License-Identifier: Apache-2.0
// Fuzzes binary files: arrays, models, checkpoints, surfels, weights and parts of a run.
#include "harness.hpp"

#include <cstdlib>

#include <relidar/base/arrays.hpp>
#include <relidar/run/checkpoint.hpp>
#include <relidar/scene/surfel_ply.hpp>
#include <relidar/score/metrics.hpp>

#include "base/codecs/npy.hpp"
#include "run/files/example_run.hpp"
#include "run/files/run_files.hpp"

namespace relidar::fuzz {
namespace {

namespace fs = std::filesystem;

void write_coverage(const fs::path& file) {
    ObservedVoxelSet coverage;
    coverage.add_segment(glm::dvec3(-9.5, 0.25, 1.5), glm::dvec3(20.0, -3.0, 2.0));
    files::save_coverage(file, coverage);
}

/// The observed share of a line must be between 0 and 1 for any content.
void read_coverage(const fs::path& file) {
    ObservedVoxelSet coverage = files::load_coverage(file);
    coverage.merge(ObservedVoxelSet(coverage));
    for (const ObservedVoxelSet::VoxelBlock& block : coverage.list_blocks()) {
        const glm::dvec3 corner =
            glm::dvec3(block.grid_index) * (ObservedVoxelSet::kCell_m * ObservedVoxelSet::kBlockCells);
        const double share = coverage.observed_fraction(corner, corner + glm::dvec3(3.0, 20.0, -7.0));
        if (!(share >= 0.0 && share <= 1.0)) std::abort();
    }
}

void write_classes(const fs::path& file) {
    files::save_class_map(file, {{{-3, 4, 5}, SurfaceClass::road}, {{1, 2, 3}, SurfaceClass::pole}});
}

void read_classes(const fs::path& file) {
    const SurfaceClassMap map = files::load_class_map(file);
    if (!map.empty()) (void)SurfaceClassLookup(map).find_class(glm::dvec3(0.1, 0.2, 0.3));
}

void write_sweeps(const fs::path& file) {
    files::save_azimuths(file, make_example_run(file.parent_path()).log);
}

void read_sweeps(const fs::path& file) {
    Log log = make_example_run(file.parent_path()).log;
    files::load_azimuths(file, log);
}

void write_network(const fs::path& file) {
    RayDropNetwork network;
    network.inputs = {"range", "drop"};
    network.widths = {4, 8};
    network.normalisation = {1.0f, 0.0f, 0.5f, -0.25f};
    network.parameters.assign(40, 0.125f);
    network.running = {0.0f, 1.0f};
    save_drop_network(file, network);
}

void read_network(const fs::path& file) { load_drop_network(file); }

void write_scatter(const fs::path& file) {
    IntensityScatterModel scatter;
    scatter.nodes = {{3, 0.5f, 1, 0, 4}, {-1, 0.0f, 0, 0, 2}, {-1, 0.0f, 0, 2, 2}};
    scatter.values = {0.0f, 0.1f, 0.2f, 0.4f};
    files::save_scatter(file, {scatter});
}

void read_scatter(const fs::path& file) {
    const std::vector<IntensityScatterModel> scatter = files::load_scatter(file, 1);
    const RenderedIntensityImage image{
        2, 2, {0.1f, 0.2f, 0.3f, 0.4f}, {5.0f, 6.0f, 7.0f, 8.0f}, {0, 0, 0, 0}, {1, 1, 1, 1}, {0, 0, 0, 0}};
    if (!scatter[0].empty()) draw_intensities(scatter[0], image, std::vector<std::uint8_t>(4, 1), 1);
}

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

std::vector<Harness> list_binary_harnesses() {
    return {
        {"coverage", written<write_coverage>, read_as_file<read_coverage>},
        {"classes", written<write_classes>, read_as_file<read_classes>},
        {"sweeps", written<write_sweeps>, read_as_file<read_sweeps>},
        {"network", written<write_network>, read_as_file<read_network>},
        {"scatter", written<write_scatter>, read_as_file<read_scatter>},
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
