// SPDX-License-Identifier: Apache-2.0
// Converts the training state to named arrays, and named arrays back to the training
// state. Checks the type and the shape of every array that is read.
#include <relidar/run/checkpoint.hpp>

#include <cmath>
#include <cstring>

#include <fmt/ranges.h>

#include "base/fail.hpp"

namespace relidar {
namespace {

/// Throws if an array of float or double (type T) contains infinity or NaN.
template <class T>
void check_finite_values(const NamedArray& array) {
    const std::size_t n_values = array.bytes.size() / sizeof(T);
    for (std::size_t i = 0; i < n_values; ++i) {
        T value;
        std::memcpy(&value, array.bytes.data() + i * sizeof(T), sizeof(T));
        if (std::isfinite(value)) continue;
        const std::size_t n_rows = array.shape.empty() ? 1 : array.shape[0], row = i / (n_values / n_rows);
        fail("row {} of array \"{}\" contains {}, expected finite numbers", row, array.name, value);
    }
}

}  // namespace

const NamedArray& Checkpoint::array(const std::string& name) const {
    const NamedArray* match = find_array(arrays, name);
    if (!match)
        fail(
            "the checkpoint of iteration {} has no array \"{}\"; it was probably written by another version "
            "of relidar and cannot be resumed; train again",
            iteration, name);
    return *match;
}

const std::string& Checkpoint::text(const std::string& name) const {
    const auto it = texts.find(name);
    if (it == texts.end())
        fail(
            "the checkpoint of iteration {} has no metadata key \"{}\", expected a checkpoint of the same "
            "version of relidar",
            iteration, name);
    return it->second;
}

void CheckpointWriter::copy_array(const std::string& name, const char* dtype, std::vector<std::size_t> shape,
                                  const void* values) {
    NamedArray& array = checkpoint_.arrays.emplace_back(NamedArray{name, dtype, std::move(shape), {}});
    array.bytes.resize(array.element_count() * static_cast<std::size_t>(dtype[1] - '0'));
    if (!array.bytes.empty()) std::memcpy(array.bytes.data(), values, array.bytes.size());
}

void CheckpointWriter::operator()(const std::string& name, const SurfelArrays& surfels) {
    const Surfels host = surfels.download();
    for (const SurfelParameterGroup& group : list_groups(surfels.parameters_used()))
        copy_array(name + "/" + group.name, "f4", group.array_shape(host.size()), group.values(host).data());
    checkpoint_.texts[name + "/" + kPrimitiveKey] = properties_of(surfels.primitive).name;
}

/// Returns a stored array. Throws unless it has this type and shape.
const NamedArray& CheckpointReader::checked_array(const std::string& name, const char* dtype,
                                                  const std::vector<std::size_t>& shape) const {
    const NamedArray& array = checkpoint_.array(name);
    if (array.dtype != dtype || array.shape != shape)
        fail(
            "checkpoint of iteration {}: the array {} has the type {} and the shape [{}], expected the type "
            "{} and the shape [{}]",
            checkpoint_.iteration, name, array.dtype, fmt::join(array.shape, ", "), dtype,
            fmt::join(shape, ", "));
    return array;
}

const NamedArray& CheckpointReader::array_of_type(const std::string& name, const char* dtype) const {
    return checked_array(name, dtype, {checkpoint_.array(name).element_count()});
}

Surfels CheckpointReader::read_surfels(const std::string& name) const {
    const NamedArray& mean = checkpoint_.array(name + "/mean");
    return read_surfels(name, mean.shape.empty() ? 0 : mean.shape[0]);
}

/// Returns the stored surfels as host arrays. Throws unless they are n_surfels.
Surfels CheckpointReader::read_surfels(const std::string& name, std::size_t n_surfels) const {
    const SurfelParameterSet parameters = read_parameter_set(
        fmt::format("checkpoint of iteration {}", checkpoint_.iteration), checkpoint_.texts,
        name + "/" + kPrimitiveKey,
        [&](const char* group) { return find_array(checkpoint_.arrays, name + "/" + group) != nullptr; });
    // Checks the shapes of all arrays before memory is allocated.
    for (const SurfelParameterGroup& group : list_groups(parameters))
        checked_array(name + "/" + group.name, "f4", group.array_shape(n_surfels));
    Surfels host;
    host.resize(n_surfels, parameters);
    for (const SurfelParameterGroup& group : list_groups(parameters))
        copy_bytes(checkpoint_.array(name + "/" + group.name), group.mutable_values(host).data());
    return host;
}

void CheckpointReader::copy_bytes(const NamedArray& array, void* destination) {
    if (!array.bytes.empty()) std::memcpy(destination, array.bytes.data(), array.bytes.size());
}

void check_finite_arrays(const Checkpoint& checkpoint) {
    for (const NamedArray& array : checkpoint.arrays) {
        if (array.dtype == "f4") check_finite_values<float>(array);
        if (array.dtype == "f8") check_finite_values<double>(array);
    }
}

}  // namespace relidar
