// SPDX-License-Identifier: Apache-2.0
// Converts the training state to named arrays, and named arrays to a training state.
// Checks the type and the shape of every array that is read.
#include <relidar/run/checkpoint.hpp>

#include <algorithm>
#include <cmath>
#include <cstring>

#include <fmt/format.h>
#include <fmt/ranges.h>

#include <relidar/base/error.hpp>

namespace relidar {
namespace {

template <class T>
void check_finite(const NamedArray& array) {
    const std::size_t n = array.bytes.size() / sizeof(T);
    for (std::size_t i = 0; i < n; ++i) {
        T value;
        std::memcpy(&value, array.bytes.data() + i * sizeof(T), sizeof(T));
        if (std::isfinite(value)) continue;
        const std::size_t rows = array.shape.empty() ? 1 : array.shape[0];
        throw DataError(fmt::format("row {1} of array \"{0}\" contains {2}, expected finite numbers",
                                    array.name, i / (n / rows), value));
    }
}

}  // namespace

const NamedArray& Checkpoint::array(const std::string& name) const {
    const NamedArray* match = find_array(arrays, name);
    if (!match)
        throw DataError(fmt::format("the checkpoint of iteration {} has no array \"{}\"", iteration, name));
    return *match;
}

const std::string& Checkpoint::text(const std::string& name) const {
    const auto it = texts.find(name);
    if (it == texts.end())
        throw DataError(
            fmt::format("the checkpoint of iteration {} has no metadata key \"{}\"", iteration, name));
    return it->second;
}

void StateWriter::put(const std::string& name, const char* dtype, std::vector<std::size_t> shape,
                      const void* values) {
    NamedArray& array = checkpoint_.arrays.emplace_back(NamedArray{name, dtype, std::move(shape), {}});
    array.bytes.resize(array.count() * static_cast<std::size_t>(dtype[1] - '0'));
    if (!array.bytes.empty()) std::memcpy(array.bytes.data(), values, array.bytes.size());
}

void StateWriter::operator()(const std::string& name, const SurfelArrays& surfels) {
    const Surfels host = surfels.download();
    for (const ParameterGroup& group : list_parameter_groups(surfels.parameters()))
        put(name + "/" + group.name, "f4", group.shape(host.size()), group.values(host).data());
    checkpoint_.texts[name + "/" + kPrimitiveKey] = get_primitive_kind(surfels.primitive).name;
}

const NamedArray& StateReader::find(const std::string& name, const char* dtype,
                                    const std::vector<std::size_t>& shape) const {
    const NamedArray& array = checkpoint_.array(name);
    if (array.dtype != dtype || array.shape != shape)
        throw DataError(fmt::format("checkpoint of iteration {}: array {}: found {} [{}], expected {} [{}]",
                                    checkpoint_.iteration, name, array.dtype, fmt::join(array.shape, ", "),
                                    dtype, fmt::join(shape, ", ")));
    return array;
}

const NamedArray& StateReader::find_rows(const std::string& name, const char* dtype) const {
    return find(name, dtype, {checkpoint_.array(name).count()});
}

Surfels StateReader::surfels(const std::string& name) const {
    const NamedArray& mean = checkpoint_.array(name + "/mean");
    return read_surfels(name, mean.shape.empty() ? 0 : mean.shape[0]);
}

Surfels StateReader::read_surfels(const std::string& name, std::size_t count) const {
    const ParameterSet parameters = read_parameter_set(
        checkpoint_.texts, name + "/" + kPrimitiveKey,
        [&](const char* group) { return find_array(checkpoint_.arrays, name + "/" + group) != nullptr; });
    // Checks the shapes of all arrays before memory is allocated.
    for (const ParameterGroup& group : list_parameter_groups(parameters))
        find(name + "/" + group.name, "f4", group.shape(count));
    Surfels host;
    host.resize(count, parameters);
    for (const ParameterGroup& group : list_parameter_groups(parameters))
        copy(checkpoint_.array(name + "/" + group.name), group.mutable_values(host).data());
    return host;
}

void StateReader::copy(const NamedArray& array, void* values) {
    if (!array.bytes.empty()) std::memcpy(values, array.bytes.data(), array.bytes.size());
}

void check_finite(const Checkpoint& checkpoint) {
    for (const NamedArray& array : checkpoint.arrays) {
        if (array.dtype == "f4") check_finite<float>(array);
        if (array.dtype == "f8") check_finite<double>(array);
    }
}

}  // namespace relidar
