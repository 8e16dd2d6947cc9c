// SPDX-License-Identifier: Apache-2.0
#include "harness.hpp"

#include <cstdlib>

#include "run/files/coverage_file.hpp"
#include "run/files/example_run.hpp"
#include "run/files/scatter_file.hpp"
#include "run/files/sweeps_file.hpp"

namespace relidar::fuzz {
namespace {

namespace fs = std::filesystem;

std::vector<std::string> make_coverage_seeds(const fs::path& folder) {
    ObservedVoxelSet coverage;
    coverage.add_segment(glm::dvec3(-9.5, 0.25, 1.5), glm::dvec3(20.0, -3.0, 2.0));
    files::save_coverage(folder / "seed", coverage);
    return {read_contents(folder / "seed")};
}

/// The observed share of a line must be between 0 and 1 for any content.
void read_coverage(std::string_view input, const fs::path& folder) {
    put(folder / "input", input);
    ObservedVoxelSet coverage = files::load_coverage(folder / "input");
    coverage.merge(ObservedVoxelSet(coverage));
    for (const ObservedVoxelSet::VoxelBlock& block : coverage.list_blocks()) {
        const glm::dvec3 corner =
            glm::dvec3(block.grid_index) * (ObservedVoxelSet::kCell_m * ObservedVoxelSet::kBlockCells);
        const double share = coverage.observed_fraction(corner, corner + glm::dvec3(3.0, 20.0, -7.0));
        if (!(share >= 0.0 && share <= 1.0)) std::abort();
    }
}

std::vector<std::string> make_classes_seeds(const fs::path& folder) {
    files::save_class_map(folder / "seed",
                          {{{-3, 4, 5}, SurfaceClass::road}, {{1, 2, 3}, SurfaceClass::pole}});
    return {read_contents(folder / "seed")};
}

void read_classes(std::string_view input, const fs::path& folder) {
    put(folder / "input", input);
    const SurfaceClassMap map = files::load_class_map(folder / "input");
    if (!map.empty()) (void)SurfaceClassLookup(map).find_class(glm::dvec3(0.1, 0.2, 0.3));
}

std::vector<std::string> make_sweeps_seeds(const fs::path& folder) {
    files::save_azimuths(folder / "seed", make_example_run(folder).sequence);
    return {read_contents(folder / "seed")};
}

void read_sweeps(std::string_view input, const fs::path& folder) {
    put(folder / "input", input);
    Log sequence = make_example_run(folder).sequence;
    files::load_azimuths(folder / "input", sequence);
}

std::vector<std::string> make_network_seeds(const fs::path& folder) {
    RayDropNetwork network;
    network.inputs = {"range", "drop"};
    network.widths = {4, 8};
    network.normalisation = {1.0f, 0.0f, 0.5f, -0.25f};
    network.parameters.assign(40, 0.125f);
    network.running = {0.0f, 1.0f};
    save_drop_network(folder / "seed", network);
    return {read_contents(folder / "seed")};
}

void read_network(std::string_view input, const fs::path& folder) {
    put(folder / "input", input);
    load_drop_network(folder / "input");
}

std::vector<std::string> make_scatter_seeds(const fs::path& folder) {
    IntensityScatterModel scatter;
    scatter.nodes = {{3, 0.5f, 1, 0, 4}, {-1, 0.0f, 0, 0, 2}, {-1, 0.0f, 0, 2, 2}};
    scatter.values = {0.0f, 0.1f, 0.2f, 0.4f};
    files::save_scatter(folder / "seed", {scatter});
    return {read_contents(folder / "seed")};
}

void read_scatter(std::string_view input, const fs::path& folder) {
    put(folder / "input", input);
    const std::vector<IntensityScatterModel> scatter = files::load_scatter(folder / "input", 1);
    const RenderedIntensityImage image{
        2, 2, {0.1f, 0.2f, 0.3f, 0.4f}, {5.0f, 6.0f, 7.0f, 8.0f}, {0, 0, 0, 0}, {1, 1, 1, 1}, {0, 0, 0, 0}};
    if (!scatter[0].empty()) draw_intensities(scatter[0], image, std::vector<std::uint8_t>(4, 1), 1);
}

}  // namespace

std::vector<Harness> run_harnesses() {
    return {{"coverage", make_coverage_seeds, read_coverage},
            {"classes", make_classes_seeds, read_classes},
            {"sweeps", make_sweeps_seeds, read_sweeps},
            {"network", make_network_seeds, read_network},
            {"scatter", make_scatter_seeds, read_scatter}};
}

}  // namespace relidar::fuzz
