// SPDX-License-Identifier: Apache-2.0
#include <relidar/base/arrays.hpp>
#include <relidar/score/metrics.hpp>

#include "base/fail.hpp"

namespace relidar {

LpipsWeights read_lpips_weights(const std::filesystem::path& path) {
    const std::vector<NamedArray> arrays = read_safetensors(path);
    const auto values = [&](const std::string& name) {
        const NamedArray* array = find_array(arrays, name);
        if (!array) fail("{}: the array {} is missing, expected the weights of LPIPS", path.string(), name);
        return array->to_floats();
    };
    LpipsWeights weights;
    for (std::size_t l = 0; l < weights.weight.size(); ++l) {
        weights.weight[l] = values(fmt::format("conv{}.weight", l));
        weights.bias[l] = values(fmt::format("conv{}.bias", l));
        weights.linear[l] = values(fmt::format("lin{}.weight", l));
    }
    return weights;
}

}  // namespace relidar
