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

template <class T>
void require_finite_array_values(const NamedArray& array) {
    const std::size_t n = array.bytes.size() / sizeof(T);
    for (std::size_t i = 0; i < n; ++i) {
        T value;
        std::memcpy(&value, array.bytes.data() + i * sizeof(T), sizeof(T));
        if (std::isfinite(value)) continue;
        const std::size_t rows = array.shape.empty() ? 1 : array.shape[0];
        fail("row {1} of array \"{0}\" contains {2}, expected finite numbers", array.name, i / (n / rows),
             value);
    }
}

}  // namespace

const NamedArray& Checkpoint::get_array(const std::string& name) const {
    const NamedArray* match = find_array(arrays, name);
    if (!match)
        fail(
            "the checkpoint of iteration {} has no array \"{}\"; it was probably written by another version "
            "of relidar and cannot be resumed; train again",
            iteration, name);
    return *match;
}

const std::string& Checkpoint::get_text(const std::string& name) const {
    const auto it = texts.find(name);
    if (it == texts.end())
        fail(
            "the checkpoint of iteration {} has no metadata key \"{}\", expected a checkpoint of the same "
            "version of relidar",
            iteration, name);
    return it->second;
}

void CheckpointWriter::copy_array_into_checkpoint(const std::string& name, const char* dtype,
                                                  std::vector<std::size_t> shape, const void* values) {
    NamedArray& array = checkpoint_.arrays.emplace_back(NamedArray{name, dtype, std::move(shape), {}});
    array.bytes.resize(array.count_array_elements() * static_cast<std::size_t>(dtype[1] - '0'));
    if (!array.bytes.empty()) std::memcpy(array.bytes.data(), values, array.bytes.size());
}

void CheckpointWriter::operator()(const std::string& name, const SurfelArrays& surfels) {
    const Surfels host = surfels.download();
    for (const SurfelParameterGroup& group : list_parameter_groups(surfels.get_parameter_set()))
        copy_array_into_checkpoint(name + "/" + group.name, "f4", group.get_array_shape(host.size()),
                                   group.values(host).data());
    checkpoint_.texts[name + "/" + kPrimitiveKey] = get_primitive_properties(surfels.primitive).name;
}

const NamedArray& CheckpointReader::get_array_of_type_and_shape(const std::string& name, const char* dtype,
                                                                const std::vector<std::size_t>& shape) const {
    const NamedArray& array = checkpoint_.get_array(name);
    if (array.dtype != dtype || array.shape != shape)
        fail(
            "checkpoint of iteration {}: the array {} has the type {} and the shape [{}], expected the type "
            "{} and the shape [{}]",
            checkpoint_.iteration, name, array.dtype, fmt::join(array.shape, ", "), dtype,
            fmt::join(shape, ", "));
    return array;
}

const NamedArray& CheckpointReader::get_array_of_any_length(const std::string& name,
                                                            const char* dtype) const {
    return get_array_of_type_and_shape(name, dtype, {checkpoint_.get_array(name).count_array_elements()});
}

Surfels CheckpointReader::read_all_surfels(const std::string& name) const {
    const NamedArray& mean = checkpoint_.get_array(name + "/mean");
    return read_surfels(name, mean.shape.empty() ? 0 : mean.shape[0]);
}

Surfels CheckpointReader::read_surfels(const std::string& name, std::size_t n_surfels) const {
    const SurfelParameterSet parameters = read_surfel_parameter_set(
        fmt::format("checkpoint of iteration {}", checkpoint_.iteration), checkpoint_.texts,
        name + "/" + kPrimitiveKey,
        [&](const char* group) { return find_array(checkpoint_.arrays, name + "/" + group) != nullptr; });
    // Checks the shapes of all arrays before memory is allocated.
    for (const SurfelParameterGroup& group : list_parameter_groups(parameters))
        get_array_of_type_and_shape(name + "/" + group.name, "f4", group.get_array_shape(n_surfels));
    Surfels host;
    host.resize(n_surfels, parameters);
    for (const SurfelParameterGroup& group : list_parameter_groups(parameters))
        copy_array_bytes(checkpoint_.get_array(name + "/" + group.name), group.mutable_values(host).data());
    return host;
}

void CheckpointReader::copy_array_bytes(const NamedArray& array, void* destination) {
    if (!array.bytes.empty()) std::memcpy(destination, array.bytes.data(), array.bytes.size());
}

void require_finite_checkpoint_arrays(const Checkpoint& checkpoint) {
    for (const NamedArray& array : checkpoint.arrays) {
        if (array.dtype == "f4") require_finite_array_values<float>(array);
        if (array.dtype == "f8") require_finite_array_values<double>(array);
    }
}

}  // namespace relidar
