// SPDX-License-Identifier: Apache-2.0
// Stores surfel parameters on the device, with one array for each parameter group. The
// same class also stores gradients or the moments of the optimizer (Adam).
#include <relidar/scene/device_scene.hpp>

#include <algorithm>
#include <limits>

#include <fmt/format.h>
#include <fmt/ranges.h>

#include <relidar/base/error.hpp>

#include "scene/shared/scene.h"

namespace relidar {

static_assert(RELIDAR_SH_COEFFICIENTS == kShCoefficients && RELIDAR_SH_FLOATS == kShFloats);

std::vector<std::size_t> ParameterGroup::shape(std::size_t n) const {
    if (row[1] > 1) return {n, row[0], row[1]};
    if (row[0] > 1) return {n, row[0]};
    return {n};
}

ParameterSet stored_parameters(const std::map<std::string, std::string>& texts, const std::string& key,
                               const std::function<bool(const char*)>& has_array) {
    std::vector<std::string> names;
    for (const PrimitiveKind& kind : kPrimitives) names.emplace_back(kind.name);
    const auto text = texts.find(key);
    if (text == texts.end())
        throw DataError(fmt::format("the metadata key \"{}\" is missing, expected one of {}", key,
                                    fmt::join(names, ", ")));
    for (const PrimitiveKind& kind : kPrimitives)
        if (kind.name == text->second) return {kind.primitive, has_array(kParameterGroups.front().name)};
    throw DataError(fmt::format("{}: found \"{}\", expected one of {}", key, text->second.substr(0, 40),
                                fmt::join(names, ", ")));
}

SurfelArrays::SurfelArrays(Device& device, std::uint32_t count, const std::string& what, ParameterSet of)
    : n(count), primitive(of.primitive), bends(of.bends) {
    for (const ParameterGroup& group : groups_of(of))
        group.mutable_device(*this) =
            Array<float>(device, std::size_t(group.floats()) * count, fmt::format("{} {}", what, group.name));
}

void SurfelArrays::upload(const Surfels& s) {
    s.check_shapes();
    if (s.size() > 0 && s.primitive != primitive)
        throw DataError(fmt::format("cannot upload surfels: found {}, expected {} like in the arrays",
                                    kind_of(s.primitive).label, kind_of(primitive).label));
    if (s.size() > 0 && s.bends != bends)
        throw DataError(fmt::format("cannot upload surfels: found {}, expected {} like in the arrays",
                                    s.bends ? "a gait" : "no gait", bends ? "a gait" : "no gait"));
    for (const ParameterGroup& group : groups_of(parameters()))
        group.mutable_device(*this).upload(group.values(s));
}

Surfels SurfelArrays::download() const {
    Surfels s;
    s.resize(n, parameters());
    for (const ParameterGroup& group : groups_of(parameters())) {
        const std::span<float> values = group.mutable_values(s);
        if (n > 0) group.device(*this).buffer().download(values.data(), values.size_bytes());
    }
    return s;
}

std::uint32_t SurfelArrays::capacity() const {
    std::size_t least = std::numeric_limits<std::uint32_t>::max();
    for (const ParameterGroup& group : groups_of(parameters()))
        least = std::min(least, group.device(*this).size() / group.floats());
    return static_cast<std::uint32_t>(least);
}

void SurfelArrays::reserve(Device& device, std::uint32_t count, const std::string& what) {
    for (const ParameterGroup& group : groups_of(parameters()))
        group.mutable_device(*this).reserve(device, std::size_t(group.floats()) * count,
                                            fmt::format("{} {}", what, group.name));
}

void SurfelArrays::fill_zero(Stream& stream) {
    for (const ParameterGroup& group : groups_of(parameters())) stream.fill(group.device(*this));
}

shared::SurfelPointers pointers_of(const SurfelArrays& a) {
    return {.mean = a.mean.address(),
            .rotation = a.rotation.address(),
            .log_scale = a.log_scale.address(),
            .opacity_logit = a.opacity_logit.address(),
            .sh = a.sh.address(),
            .log_scale_w = a.log_scale_w.address(),
            .gait = a.gait.address()};
}

}  // namespace relidar
