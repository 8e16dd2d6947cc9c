// SPDX-License-Identifier: Apache-2.0
// Embree, another program's search, must find the hits that the reference finds by
// testing every surfel. Each surfel is bounded by two triangles (M3). Triangles that are
// too small, and hits that the reference loses, show up as differences.
#if __has_include(<embree4/rtcore.h>)
#include <embree4/rtcore.h>
#else
#include <embree3/rtcore.h>
#endif

#include <gtest/gtest.h>

#include <limits>
#include <memory>
#include <set>

#include "../../support/surfels.hpp"
#include "cases.hpp"
#include "hit_comparison.hpp"

namespace relidar {
namespace {

using namespace reference;

constexpr std::uint64_t kEmbreeSeed = 20261121;

#if RTC_VERSION_MAJOR >= 4
using Context = RTCRayQueryContext;
#else
using Context = RTCIntersectContext;
#endif

/// Triangles that a ray crosses. Embree passes only the address of the context, so it is
/// the first member.
struct Candidates {
    Context context;
    std::set<unsigned> triangles;
};

/// Rejects each triangle, so that Embree continues behind it.
void collect(const RTCFilterFunctionNArguments* arguments) {
    if (arguments->valid[0] != -1) return;
    reinterpret_cast<Candidates*>(arguments->context)
        ->triangles.insert(RTCHitN_primID(arguments->hit, arguments->N, 0));
    arguments->valid[0] = 0;
}

/// All surfels of all instances as triangles in the world frame.
class EmbreeWorld {
public:
    explicit EmbreeWorld(const World& world) {
        std::vector<glm::vec3> corners;
        for (std::uint32_t i = 0; i < world.instances.size(); ++i) {
            const Placement& placed = world.instances[i];
            rows_.push_back(make_model_from_world_rows(placed.world_from_model));
            for (std::uint32_t s = placed.first; s < placed.first + placed.count; ++s) {
                const Activated a = activate(world.surfels[s]);
                const double k = std::sqrt(2.0 * std::log(a.opacity / double(model_.alpha_min)));
                // The library's triangles are larger than the visible surfel, too.
                const glm::dvec2 half_m = k * a.scale * 1.002 + 1e-4;
                const glm::dvec3 u = half_m.x * a.rotation[0], v = half_m.y * a.rotation[1];
                // Surfels that are never hit: too transparent, or not finite in float.
                if (!std::isfinite(glm::dot(u + v + a.mean, glm::dvec3(1.0))) || glm::length(u + v) > 1e5)
                    continue;
                for (const glm::dvec3& corner : {-u - v, u - v, u + v, -u + v})
                    corners.emplace_back(placed.world_from_model * (a.mean + corner));
                sources_.push_back({0.0, i, s});
                records_.push_back(make_float_record(world.surfels[s]));
            }
        }
        RTCGeometry mesh = rtcNewGeometry(device_.get(), RTC_GEOMETRY_TYPE_TRIANGLE);
        const auto buffer = [&](RTCBufferType type, RTCFormat format, std::size_t n) {
            return rtcSetNewGeometryBuffer(mesh, type, 0, format, 12, n);
        };
        std::ranges::copy(corners, static_cast<glm::vec3*>(
                                       buffer(RTC_BUFFER_TYPE_VERTEX, RTC_FORMAT_FLOAT3, corners.size())));
        auto* index =
            static_cast<unsigned*>(buffer(RTC_BUFFER_TYPE_INDEX, RTC_FORMAT_UINT3, 2 * sources_.size()));
        for (unsigned i = 0; i < sources_.size(); ++i)
            for (const unsigned corner : {0u, 1u, 2u, 0u, 2u, 3u}) *index++ = 4 * i + corner;
        rtcSetGeometryIntersectFilterFunction(mesh, collect);
        rtcCommitGeometry(mesh);
        rtcAttachGeometry(scene_.get(), mesh);
        rtcReleaseGeometry(mesh);
        rtcSetSceneFlags(scene_.get(), RTC_SCENE_FLAG_ROBUST);
        rtcCommitScene(scene_.get());
        EXPECT_EQ(rtcGetDeviceError(device_.get()), RTC_ERROR_NONE);
    }

    std::vector<Hit> list_hits(const Ray& ray) const {
        Candidates candidates;
        RTCRayHit target{};
        const auto& o = ray.origin;
        const auto& d = ray.direction;
        target.ray = {float(o.x), float(o.y), float(o.z),
                      0.0f,       float(d.x), float(d.y),
                      float(d.z), 0.0f,       std::numeric_limits<float>::infinity(),
                      ~0u,        0u,         0u};
        target.hit.geomID = RTC_INVALID_GEOMETRY_ID;
#if RTC_VERSION_MAJOR >= 4
        rtcInitRayQueryContext(&candidates.context);
        RTCIntersectArguments arguments;
        rtcInitIntersectArguments(&arguments);
        arguments.context = &candidates.context;
        rtcIntersect1(scene_.get(), &target, &arguments);
#else
        rtcInitIntersectContext(&candidates.context);
        rtcIntersect1(scene_.get(), &candidates.context, &target);
#endif
        std::set<Hit> hits;  // a ray through the diagonal crosses both triangles
        for (const unsigned triangle : candidates.triangles) {
            Hit hit = sources_[triangle / 2];
            const LocalRay<float> local =
                to_model(rows_[hit.instance], glm::vec3(ray.origin), glm::vec3(ray.direction));
            const auto found = intersect(records_[triangle / 2], local, model_);
            if (found) hit.t = double(found->t), hits.insert(hit);
        }
        return {hits.begin(), hits.end()};
    }

private:
    ImageModel model_;
    std::vector<FloatRows> rows_;       ///< [instance]
    std::vector<Hit> sources_;          ///< [two triangles] instance and surfel
    std::vector<FloatRecord> records_;  ///< [two triangles]
    std::unique_ptr<RTCDeviceTy, decltype(&rtcReleaseDevice)> device_{rtcNewDevice("threads=1"),
                                                                      rtcReleaseDevice};
    std::unique_ptr<RTCSceneTy, decltype(&rtcReleaseScene)> scene_{rtcNewScene(device_.get()),
                                                                   rtcReleaseScene};
};

void compare(const test::TraversalCase& c, std::size_t min_hits) {
    const World world = to_world(c);
    const BruteForce expected(world, {}, Precision::float_record);
    const EmbreeWorld embree(world);
    test::HitDifferences d;
    const std::vector<Ray> rays = test::to_reference(c.rays);
    for (std::size_t i = 0; i < rays.size(); ++i)
        compare_hits(world, {}, rays[i], i, expected.list_hits(rays[i]), embree.list_hits(rays[i]), d);
    EXPECT_EQ(d.n_errors, 0u) << c.name << ", seed " << kEmbreeSeed << ": " << d.first_error;
    EXPECT_LE(d.n_different_rays, c.grazing ? d.n_rays / 1000 : 0) << d.summary(c.name);
    EXPECT_GE(d.n_hits, min_hits);
}

TEST(Embree, FindsTheHitsOfTheReference) {
    for (const test::TraversalCase& c : test::make_conformance_cases(kEmbreeSeed, 6000)) compare(c, 0);
}

TEST(Embree, FindsTheHitsOf100000Rays) {
    compare(test::make_random_case(kEmbreeSeed, 600, 100'000), 400'000);
}

}  // namespace
}  // namespace relidar
