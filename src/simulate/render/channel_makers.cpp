// SPDX-License-Identifier: Apache-2.0
#include "simulate/render/channel_makers.hpp"

#include <algorithm>
#include <string_view>

#include <relidar/diff/forward.hpp>
#include <relidar/simulate/weather.hpp>

namespace relidar {
namespace {

/// Returns the unit normal of the surface that each ray hit. The normal is in the
/// sensor's frame at the firing time of the ray.
std::vector<glm::vec3> seen_normals(const Rendering& rendering, const RenderedScan& scan) {
    std::vector<glm::vec3> normal(rendering.size(), glm::vec3(0.0f));
    FiringPoses firing(scan);
    for (std::size_t i = 0; i < normal.size(); ++i) {
        if (rendering.weight[i] < kMinWeight) continue;
        const glm::dvec3 in_sensor = glm::conjugate(firing.at(i).rotation) * glm::dvec3(rendering.normal[i]);
        const double length = glm::length(in_sensor);
        if (length > 0.0) normal[i] = glm::vec3(in_sensor / length);
    }
    return normal;
}

ChannelValues normals(const Rendering& rendering, const RenderedScan& scan) {
    return seen_normals(rendering, scan);
}

ChannelValues incidence(std::span<const shared::MeasuredRay> measured) {
    std::vector<float> cosine;
    for (const shared::MeasuredRay& ray : measured) cosine.push_back(ray.incidence);
    return cosine;
}

ChannelValues spread(const RenderedScan& scan, const SeenByLog&) { return range_spread(scan); }

ChannelValues seen(const RenderedScan& scan, const SeenByLog& log) {
    if (log.coverage.empty()) return {};
    std::vector<std::size_t> rays;
    for (std::size_t i = 0; i < scan.median_range_m.size(); ++i) rays.push_back(i);
    return seen_shares(scan, rays, log);
}

// Returns "surface" for all rays. If there is weather, add_weather() later overwrites the
// values with the cause of each return.
ChannelValues surfaces(const RenderedScan& scan, const SeenByLog&) {
    return std::vector<std::int32_t>(scan.median_range_m.size(), std::int32_t(PointSource::surface));
}

ChannelValues surfel_drop_prob(const RenderedScan& scan, const SeenByLog&) { return scan.image.drop_prob; }

/// Describes how an optional channel is computed. Exactly one of the three functions is
/// set.
struct Maker {
    std::string_view name;
    ChannelValues (*of_rendering)(const Rendering&, const RenderedScan&);
    ChannelValues (*of_measured)(std::span<const shared::MeasuredRay>);
    ChannelValues (*of_scan)(const RenderedScan&, const SeenByLog&);
};
constexpr Maker kMakers[] = {
    {"normal", normals, nullptr, nullptr},
    {kIncidence, nullptr, incidence, nullptr},
    {"spread", nullptr, nullptr, spread},
    {"seen", nullptr, nullptr, seen},
    {"surfel_drop_prob", nullptr, nullptr, surfel_drop_prob},
    {"source", nullptr, nullptr, surfaces},
};

Maker maker_of(const ChannelInfo& channel) {
    const auto* maker = std::ranges::find(kMakers, channel.name, &Maker::name);
    // tests/simulate/render/channels_test.cpp checks that each channel has a row.
    return maker == std::end(kMakers) ? Maker{} : *maker;
}

}  // namespace

bool needs_rendering(const std::vector<ChannelInfo>& wanted) {
    return std::ranges::any_of(
        wanted, [](const ChannelInfo& channel) { return maker_of(channel).of_rendering != nullptr; });
}

void add_ray_channels(RenderedScan& scan, std::span<const shared::MeasuredRay> measured,
                      const Rendering& rendering, const std::vector<ChannelInfo>& wanted) {
    for (const ChannelInfo& channel : wanted) {
        const Maker maker = maker_of(channel);
        if (maker.of_rendering) scan.channels.push_back({channel, maker.of_rendering(rendering, scan)});
        if (maker.of_measured) scan.channels.push_back({channel, maker.of_measured(measured)});
    }
}

void add_scan_channels(RenderedScan& scan, const SeenByLog& log, const std::vector<ChannelInfo>& wanted) {
    for (const ChannelInfo& channel : wanted) {
        const Maker maker = maker_of(channel);
        if (!maker.of_scan) continue;
        ChannelValues values = maker.of_scan(scan, log);
        if (size(values) == scan.image.range_m.size()) scan.channels.push_back({channel, std::move(values)});
    }
}

}  // namespace relidar
