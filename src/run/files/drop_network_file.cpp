// SPDX-License-Identifier: Apache-2.0
// Reads and writes a ray-drop network as a safetensors file. The parameters are arrays,
// and the architecture is text in the metadata.
#include <cmath>

#include <fmt/format.h>
#include <nlohmann/json.hpp>

#include <relidar/base/arrays.hpp>
#include <relidar/base/error.hpp>
#include <relidar/run/run.hpp>

#include "base/fail.hpp"
#include "base/files.hpp"
#include "base/json_field.hpp"
#include "run/files/file_format.hpp"

namespace relidar {
namespace {

constexpr const char* kNetworkFormat = "relidar drop network";
constexpr const char* kNetworkVersion = "1";

std::vector<float> require_finite_float_array(const std::vector<NamedArray>& arrays, const char* name,
                                              const std::string& file_name) {
    const NamedArray* array = find_array(arrays, name);
    if (!array || array->dtype != "f4")
        fail("{}: the array {} is missing or its type is not f4", file_name, name);
    std::vector<float> values = array->convert_to_floats();
    for (std::size_t i = 0; i < values.size(); ++i)
        if (!std::isfinite(values[i]))
            fail("{}: array {}: entry {} is {}, expected a finite number", file_name, name, i, values[i]);
    return values;
}

void read_network_architecture(const JsonField& architecture, RayDropNetwork& network) {
    network.image = architecture.at("image").get_string();
    const JsonField inputs = architecture.at("inputs"), widths = architecture.at("widths");
    if (inputs.size() < 1 || inputs.size() > 64)
        inputs.throw_field_error(fmt::format("found {} inputs", inputs.size()), "expected 1 to 64 inputs");
    if (widths.size() < 1 || widths.size() > 8)
        widths.throw_field_error(fmt::format("found {} channel numbers", widths.size()),
                                 "expected 1 to 8 channel numbers, one per level");
    for (std::size_t i = 0; i < inputs.size(); ++i) network.inputs.push_back(inputs.at(i).get_string());
    for (std::size_t i = 0; i < widths.size(); ++i)
        network.widths.push_back(std::uint32_t(widths.at(i).get_integer_in_range(2, 4096)));
    network.heads = std::uint32_t(architecture.at("heads").get_integer_in_range(0, network.widths.back()));
    if (network.heads > 0 && network.widths.back() % network.heads != 0)
        architecture.at("heads").throw_field_error(
            fmt::format("found {}", network.heads),
            fmt::format("expected a divisor of {}", network.widths.back()));
    network.taps = std::uint32_t(architecture.at("taps").get_integer_in_range(1, 9));
    network.residual = architecture.at("residual").get_integer_in_range(0, 1) != 0;
}

}  // namespace

void save_ray_drop_network(const std::filesystem::path& path, const RayDropNetwork& network) {
    const auto array = [](const char* name, const std::vector<float>& values) {
        return make_array(name, {values.size()}, values.data(), values.size());
    };
    const nlohmann::ordered_json shape = {{"image", network.image},   {"inputs", network.inputs},
                                          {"widths", network.widths}, {"heads", network.heads},
                                          {"taps", network.taps},     {"residual", int(network.residual)}};
    write_safetensors(path,
                      {array("normalisation", network.normalisation), array("parameters", network.parameters),
                       array("running", network.running)},
                      {{"format", kNetworkFormat},
                       {"version", kNetworkVersion},
                       {"relidar", RELIDAR_VERSION},
                       {"shape", shape.dump()}});
}

RayDropNetwork load_ray_drop_network(const std::filesystem::path& path) {
    const std::string file = path.string();
    std::map<std::string, std::string> metadata;
    const std::vector<NamedArray> arrays = read_safetensors(path, &metadata);
    run_detail::require_format_and_version(metadata, file, kNetworkFormat, kNetworkVersion);
    RayDropNetwork network;
    const std::string where = file + ": metadata shape";
    const nlohmann::json shape = parse_json(metadata["shape"], where);
    read_network_architecture(JsonField(shape, where, ""), network);
    network.normalisation = require_finite_float_array(arrays, "normalisation", file);
    network.parameters = require_finite_float_array(arrays, "parameters", file);
    network.running = require_finite_float_array(arrays, "running", file);
    return network;
}

}  // namespace relidar
