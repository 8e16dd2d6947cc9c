// SPDX-License-Identifier: Apache-2.0
#include <nlohmann/json.hpp>

#include <relidar/run/run.hpp>

#include "base/files.hpp"
#include "base/json_field.hpp"
#include "run/files/file_format.hpp"

namespace relidar {
namespace {

constexpr const char* kNetworkFormat = "relidar drop network";
constexpr const char* kActorLogits = "actor_logits";

/// Reads the shape of a ray-drop network from JSON: kind of images, names of the inputs,
/// channels of each level (widths), heads of the attention, and filter size (taps).
void read_architecture(const JsonField& architecture, RayDropNetwork& network) {
    network.image = architecture.at("image").text();
    const JsonField inputs = architecture.at("inputs"), widths = architecture.at("widths");
    if (inputs.size() < 1 || inputs.size() > 64)
        inputs.reject(fmt::format("found {} inputs", inputs.size()), "expected 1 to 64 inputs");
    if (widths.size() < 1 || widths.size() > 8)
        widths.reject(fmt::format("found {} channel numbers", widths.size()),
                      "expected 1 to 8 channel numbers, one per level");
    network.inputs = inputs.list([](const JsonField& name) { return name.text(); });
    network.widths = widths.list([](const JsonField& n) { return std::uint32_t(n.integer_in(2, 4096)); });
    network.heads = std::uint32_t(architecture.at("heads").integer_in(0, network.widths.back()));
    // Attention divides the channels of the last level evenly among its heads.
    if (network.heads > 0 && network.widths.back() % network.heads != 0)
        architecture.at("heads").reject(fmt::format("found {}", network.heads),
                                        fmt::format("expected a divisor of {}", network.widths.back()));
    network.taps = std::uint32_t(architecture.at("taps").integer_in(1, 9));
    network.residual = architecture.at("residual").integer_in(0, 1) != 0;
}

}  // namespace

void save_drop_network(const std::filesystem::path& path, const RayDropNetwork& network) {
    using files::make_vector_array;
    const nlohmann::ordered_json shape = {{"image", network.image},   {"inputs", network.inputs},
                                          {"widths", network.widths}, {"heads", network.heads},
                                          {"taps", network.taps},     {"residual", int(network.residual)}};
    std::vector<NamedArray> arrays = {make_vector_array("normalisation", network.normalisation),
                                      make_vector_array("parameters", network.parameters),
                                      make_vector_array("running", network.running)};
    if (!network.actor_logits.empty())
        arrays.push_back(make_vector_array(kActorLogits, network.actor_logits));
    files::write_array_file(path, arrays, kNetworkFormat, {{"shape", shape.dump()}});
}

/// Loads a ray-drop network: its shape from the metadata, and three arrays of numbers.
RayDropNetwork load_drop_network(const std::filesystem::path& path) {
    files::ArrayFile file(path, kNetworkFormat);
    RayDropNetwork network;
    const std::string where = file.path + ": metadata shape";
    const nlohmann::json shape = parse_json(file.metadata["shape"], where);
    read_architecture(JsonField(shape, where, ""), network);
    for (const auto& [name, values] : {std::pair("normalisation", &network.normalisation),
                                       {"parameters", &network.parameters},
                                       {"running", &network.running}}) {
        const std::vector<double> numbers = file.find_numbers(name, "f4");
        values->assign(numbers.begin(), numbers.end());
    }
    // The network "paper" and networks of scenes without actors have no such offsets.
    if (find_array(file.arrays, kActorLogits)) {
        const std::vector<double> logits = file.find_numbers(kActorLogits, "f4");
        network.actor_logits.assign(logits.begin(), logits.end());
    }
    return network;
}

}  // namespace relidar
