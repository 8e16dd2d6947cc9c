// SPDX-License-Identifier: Apache-2.0
// The traversal contract on the device (forward/collect_hits): ray query over triangles and over boxes, and brute force, against the
// host's brute force and Embree.
#include "device_hits.hpp"

namespace relidar {
namespace {

using test::HitDifferences;
using test::hits_of;
using test::kMaxHits;
using test::TraversalCase;

class DeviceHits : public test::DeviceHits {
protected:
    CollectedHits collect(const TraversalCase& c, const AccelOptions& accel, const TraceOptions& trace) {
        test::SceneAndPoses placed = test::to_scene(c.surfels, c.instances);
        return collect_hits(device(), {&placed.scene, placed.world_from_instance, {}, accel, trace}, c.rays, kMaxHits);
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
