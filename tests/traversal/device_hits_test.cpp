// SPDX-License-Identifier: Apache-2.0
// The traversal contract on the device (forward/collect_hits): ray query over triangles and over boxes, and brute force, against the
// host's brute force and Embree. All decide by the same float function, so ordered ids must be equal; what single precision cannot
// decide (a hit within rounding of its outline, two t within rounding of each other) is counted and bounded.
#include "../support/device.hpp"
#include "../support/placed.hpp"
#include "cases.hpp"
#include "hit_comparison.hpp"

namespace relidar {
namespace {

using test::HitDifferences;
using test::TraversalCase;

constexpr std::uint32_t kMaxHits = 256;

std::vector<reference::Hit> hits_of(const CollectedHits& c, std::size_t ray) {
    std::vector<reference::Hit> hits;
    for (std::uint32_t i = 0; i < std::min(c.counts[ray], c.max_hits); ++i) {
        const std::size_t slot = ray * c.max_hits + i;
        hits.push_back({c.t[slot], c.instance[slot], c.surfel[slot]});
    }
    return hits;
}

class DeviceHits : public test::DeviceTest {
protected:
    CollectedHits collect(const TraversalCase& c, const AccelOptions& accel, const TraceOptions& trace) {
        test::SceneAndPoses placed = test::to_scene(c.surfels, c.instances);
        return collect_hits(device(), {&placed.scene, placed.world_from_instance, {}, accel, trace}, c.rays, kMaxHits);
    }

    /// Compares every ray of a case with the host's brute force (float canonical).
    HitDifferences compare(const TraversalCase& c, const reference::HitProvider& expected, const CollectedHits& actual) {
        const reference::World world = test::to_world(c);
        const std::vector<reference::Ray> rays = test::to_reference(c.rays);
        HitDifferences differences;
        for (std::size_t i = 0; i < rays.size(); ++i) {
            EXPECT_LE(actual.counts[i], kMaxHits) << "the case has more hits than the test keeps";
            test::compare_hits(world, {}, rays[i], i, reference::all_hits(expected, rays[i], 64), hits_of(actual, i), differences);
        }
        return differences;
    }

    void expect_equal(const TraversalCase& c, const HitDifferences& d, const std::string& title) {
        EXPECT_EQ(d.n_errors, 0u) << d.summary(title) << "\n" << d.first_error;
        const std::size_t allowed = c.grazing ? d.n_rays / 100 : 2 + d.n_rays / 5000;
        EXPECT_LE(d.n_different_rays, allowed) << d.summary(title);
    }
};

struct Setting {
    const char* name;
    AccelOptions accel;
    TraceOptions trace;
};

std::vector<Setting> providers(int chunk) {
    return {{"triangles", {.proxy = Proxy::triangles}, {.chunk = chunk}},
            {"boxes", {.proxy = Proxy::boxes}, {.chunk = chunk}},
            {"brute force", {.proxy = Proxy::boxes}, {.chunk = chunk, .brute_force = true}}};
}

TEST_F(DeviceHits, ConformanceCases) {
    for (const TraversalCase& c : test::conformance_cases(11, 2000)) {
        const reference::BruteForce brute(test::to_world(c), {}, reference::Precision::float_record);
        for (const int chunk : {1, 3, 16, 32})
            for (const Setting& s : providers(chunk)) {
                const std::string title = c.name + ", " + s.name + ", chunk " + std::to_string(chunk);
                expect_equal(c, compare(c, brute, collect(c, s.accel, s.trace)), title);
            }
    }
}

/// Issue 1, item 3: 10^5 rays, with ties, diagonals and grazing rays, chunk sizes 1 to 32.
TEST_F(DeviceHits, HundredThousandRays) {
    TraversalCase c = test::random_case(77, 600, 100000);
    const reference::EmbreeFilter embree(test::to_world(c), {});
    int chunk = 1;
    for (const Setting& s : providers(1)) {
        TraceOptions trace = s.trace;
        trace.chunk = chunk;
        chunk = chunk == 1 ? 16 : 32;
        const HitDifferences d = compare(c, embree, collect(c, s.accel, trace));
        std::printf("%s\n", d.summary(std::string(s.name) + " against Embree, chunk " + std::to_string(trace.chunk)).c_str());
        expect_equal(c, d, s.name);
    }
}

TEST_F(DeviceHits, ChunkSizeDoesNotMatter) {
    const TraversalCase c = test::random_case(5, 400, 2000);
    const CollectedHits expected = collect(c, {.proxy = Proxy::boxes}, {.chunk = 64});
    for (const int chunk : {1, 2, 5, 8, 24, 32})
        for (const Proxy proxy : {Proxy::boxes, Proxy::triangles}) {
            const CollectedHits actual = collect(c, {.proxy = proxy}, {.chunk = chunk});
            EXPECT_EQ(actual.counts, expected.counts) << "chunk " << chunk;
            for (std::size_t ray = 0; ray < c.rays.size(); ++ray) ASSERT_EQ(hits_of(actual, ray), hits_of(expected, ray)) << "chunk " << chunk << ", ray " << ray;
        }
}

}  // namespace
}  // namespace relidar
