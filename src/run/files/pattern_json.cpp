// SPDX-License-Identifier: Apache-2.0
// Scan patterns as JSON: {"window": {...}}, {"rosette": {...}} or {"rays": {...}}. Angles
// are in radians, as in all of scene.json.
#include "run/files/pattern_json.hpp"

#include <cmath>

#include <fmt/format.h>
#include <nlohmann/json.hpp>

#include "base/json_field.hpp"

namespace relidar::run_detail {
namespace {

using Json = nlohmann::ordered_json;

constexpr double kTurn = 10.0;  // limit for angles in radians, more than one revolution

Json vectors_json(const ScanArray<glm::vec3>& vectors) {
    Json json = Json::array();
    for (const glm::vec3& v : vectors) json.push_back(v.x), json.push_back(v.y), json.push_back(v.z);
    return json;
}

Json json_of(const ScanningWindow& w) {
    return {{"window",
             {{"name", w.name},
              {"rows", w.rows},
              {"columns", w.columns},
              {"left_rad", w.left_rad},
              {"right_rad", w.right_rad},
              {"top_rad", w.top_rad},
              {"bottom_rad", w.bottom_rad},
              {"period_s", w.period_s},
              {"divergence_rad", w.divergence_rad}}}};
}

Json json_of(const Rosette& r) {
    return {{"rosette",
             {{"name", r.name},
              {"deflection_rad", r.deflection_rad},
              {"first_hz", r.first_hz},
              {"second_hz", r.second_hz},
              {"rays", r.n_rays},
              {"period_s", r.period_s},
              {"divergence_rad", r.divergence_rad}}}};
}

Json json_of(const RayTable& rays) {
    Json json = {{"rows", rays.rows},
                 {"columns", rays.columns},
                 {"origin", vectors_json(rays.origin)},
                 {"direction", vectors_json(rays.direction)},
                 {"time_offset_s", rays.time_offset_s},
                 {"channel", rays.channel},
                 {"divergence_rad", rays.divergence_rad}};
    if (!rays.ray_divergence_rad.empty()) json["ray_divergence_rad"] = rays.ray_divergence_rad;
    return {{"rays", json}};
}

ScanningWindow read_window(const JsonField& field) {
    ScanningWindow window{.name = field.at("name").text(),
                          .rows = static_cast<int>(field.at("rows").integer(1, 65535)),
                          .columns = static_cast<int>(field.at("columns").integer(1, 1'000'000)),
                          .left_rad = field.at("left_rad").number(-kTurn, kTurn),
                          .right_rad = field.at("right_rad").number(-kTurn, kTurn),
                          .top_rad = field.at("top_rad").number(-kTurn, kTurn),
                          .bottom_rad = field.at("bottom_rad").number(-kTurn, kTurn),
                          .period_s = field.at("period_s").number(1e-6, 3600.0),
                          .divergence_rad = field.at("divergence_rad").number(0.0, kTurn)};
    if (std::size_t(window.rows) * std::size_t(window.columns) > kMaxRays)
        field.fail(fmt::format("found {} rows x {} columns", window.rows, window.columns),
                   fmt::format("expected at most {} rays", kMaxRays));
    return window;
}

Rosette read_rosette(const JsonField& field) {
    return {.name = field.at("name").text(),
            .deflection_rad = field.at("deflection_rad").number(-kTurn, kTurn),
            .first_hz = field.at("first_hz").number(-1e6, 1e6),
            .second_hz = field.at("second_hz").number(-1e6, 1e6),
            .n_rays = static_cast<int>(field.at("rays").integer(1, std::int64_t(kMaxRays))),
            .period_s = field.at("period_s").number(1e-6, 3600.0),
            .divergence_rad = field.at("divergence_rad").number(0.0, kTurn)};
}

std::vector<double> numbers(const JsonField& field, std::size_t n, double largest) {
    std::vector<double> values = field.numbers();
    if (values.size() != n)
        field.fail(fmt::format("found {} numbers", values.size()), fmt::format("expected {}", n));
    for (const double v : values)
        if (!(std::abs(v) <= largest))
            field.fail(fmt::format("found {}", v), fmt::format("expected numbers within {}", largest));
    return values;
}

ScanArray<glm::vec3> vectors(const JsonField& field, std::size_t n, double largest) {
    const std::vector<double> values = numbers(field, 3 * n, largest);
    ScanArray<glm::vec3> vectors;
    for (std::size_t i = 0; i < n; ++i)
        vectors.emplace_back(values[3 * i], values[3 * i + 1], values[3 * i + 2]);
    return vectors;
}

RayTable read_rays(const JsonField& field) {
    RayTable rays;
    rays.rows = static_cast<int>(field.at("rows").integer(1, std::int64_t(kMaxRays)));
    rays.columns = static_cast<int>(field.at("columns").integer(1, std::int64_t(kMaxRays)));
    const std::size_t n = std::size_t(rays.rows) * std::size_t(rays.columns);
    rays.origin = vectors(field.at("origin"), n, 1000.0);
    rays.direction = vectors(field.at("direction"), n, 1.001);
    for (const double t : numbers(field.at("time_offset_s"), n, 10.0))
        rays.time_offset_s.push_back(static_cast<float>(t));
    for (const double c : numbers(field.at("channel"), n, 65535.0))
        rays.channel.push_back(static_cast<std::uint16_t>(std::abs(c)));
    for (const glm::vec3& d : rays.direction)
        if (!(std::abs(glm::length(d) - 1.0f) < 1e-3f))
            field.at("direction").fail(fmt::format("found length {}", glm::length(d)), "expected 1");
    rays.divergence_rad = static_cast<float>(field.at("divergence_rad").number(0.0, kTurn));
    if (!field.has("ray_divergence_rad")) return rays;
    const JsonField of_rays = field.at("ray_divergence_rad");
    for (const double angle : numbers(of_rays, n, kTurn)) {
        if (angle < 0.0) of_rays.fail(fmt::format("found {}", angle), "expected none below 0");
        rays.ray_divergence_rad.push_back(static_cast<float>(angle));
    }
    return rays;
}

}  // namespace

Json pattern_json(const FixedPattern& pattern) {
    return std::visit([](const auto& p) { return json_of(p); }, pattern);
}

FixedPattern read_pattern(const JsonField& field) {
    if (field.has("window")) return read_window(field.at("window"));
    if (field.has("rosette")) return read_rosette(field.at("rosette"));
    return read_rays(field.at("rays"));
}

}  // namespace relidar::run_detail
