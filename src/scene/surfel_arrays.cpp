// SPDX-License-Identifier: Apache-2.0
// Stores surfel parameters on the device, with one array for each parameter group. The
// same class also stores gradients or the moments of the optimizer (Adam).
#include <relidar/scene/device_scene.hpp>

#include <fmt/ranges.h>

#include "base/fail.hpp"
#include "scene/shared/scene.h"

namespace relidar {

static_assert(RELIDAR_SH_COEFFICIENTS == kShCoefficients && RELIDAR_SH_FLOATS == kShFloats);

std::vector<std::size_t> SurfelParameterGroup::array_shape(std::size_t n_surfels) const {
    if (row[1] > 1) return {n_surfels, row[0], row[1]};
    if (row[0] > 1) return {n_surfels, row[0]};
    return {n_surfels};
}

SurfelParameterSet read_parameter_set(const std::string& where,
                                      const std::map<std::string, std::string>& metadata,
                                      const std::string& key,
                                      const std::function<bool(const char*)>& has_array) {
    std::vector<std::string> names;
    for (const PrimitiveProperties& kind : kPrimitives) names.emplace_back(kind.name);
    const auto text = metadata.find(key);
    if (text == metadata.end()) fail("{}: the metadata key \"{}\" is missing", where, key);
    const bool bends = has_array(kParameterGroups.front().name);  // the gait
    for (const PrimitiveProperties& kind : kPrimitives)
        if (kind.name == text->second) return {kind.primitive, bends};
    fail("{}: {}: found \"{}\", expected one of {}", where, key, text->second.substr(0, 40),
         fmt::join(names, ", "));
}

SurfelArrays::SurfelArrays(Device& device, std::uint32_t count, const std::string& text,
                           SurfelParameterSet parameters)
    : n(count), primitive(parameters.primitive), bends(parameters.bends) {
    for (const SurfelParameterGroup& group : list_groups(parameters))
        group.mutable_device(*this) = Array<float>(device, std::size_t(group.count_floats()) * count,
                                                   fmt::format("{} {}", text, group.name));
}

void SurfelArrays::upload(const Surfels& surfels) { upload_at(0, surfels); }

void SurfelArrays::check_group(const Surfels& surfels) const {
    surfels.check_lengths();
    if (surfels.size() > 0 && surfels.primitive != primitive)
        fail("cannot upload {} to arrays of {}", properties_of(surfels.primitive).label,
             properties_of(primitive).label);
    if (surfels.size() > 0 && surfels.bends != bends)
        fail("cannot upload surfels with{} gait to arrays with{} gait", surfels.bends ? "" : "out",
             bends ? "" : "out");
}

void SurfelArrays::upload_at(std::uint32_t first, const Surfels& surfels) {
    check_group(surfels);
    for (const SurfelParameterGroup& group : list_groups(parameters_used()))
        group.mutable_device(*this).upload(group.values(surfels), std::size_t(first) * group.count_floats());
}

/// Copies `count` surfels from index `first` on to the host.
Surfels SurfelArrays::download_range(std::uint32_t first, std::uint32_t count) const {
    Surfels s;
    s.resize(count, parameters_used());
    for (const SurfelParameterGroup& group : list_groups(parameters_used())) {
        const std::span<float> values = group.mutable_values(s);
        if (count > 0)
            group.device(*this).buffer().download(values.data(), values.size_bytes(),
                                                  std::size_t(first) * group.count_floats() * sizeof(float));
    }
    return s;
}

std::uint32_t SurfelArrays::capacity() const {
    std::size_t least = std::numeric_limits<std::uint32_t>::max();
    for (const SurfelParameterGroup& group : list_groups(parameters_used()))
        least = std::min(least, group.device(*this).size() / group.count_floats());
    return static_cast<std::uint32_t>(least);
}

void SurfelArrays::reserve(Device& device, std::uint32_t count, const std::string& text) {
    for (const SurfelParameterGroup& group : list_groups(parameters_used()))
        group.mutable_device(*this).reserve(device, std::size_t(group.count_floats()) * count,
                                            fmt::format("{} {}", text, group.name));
}

void SurfelArrays::fill_zero(Stream& stream) {
    for (const SurfelParameterGroup& group : list_groups(parameters_used())) stream.fill(group.device(*this));
}

shared::SurfelPointers surfel_pointers(const SurfelArrays& arrays) {
    return {.mean = arrays.mean.address(),
            .rotation = arrays.rotation.address(),
            .log_scale = arrays.log_scale.address(),
            .opacity_logit = arrays.opacity_logit.address(),
            .sh = arrays.sh.address(),
            .log_scale_w = arrays.log_scale_w.address(),
            .gait = arrays.gait.address()};
}

}  // namespace relidar
