// SPDX-License-Identifier: Apache-2.0
// Provides the fixture for the traversal tests of the device. Compares the hits of the
// device with the hits that the host finds. Both use the same float
// intersection, so the ordered ids must be equal. Differences within rounding (a hit on
// its outline, two almost equal t) are counted and limited.
#pragma once

#include <algorithm>
#include <string>
#include <vector>

#include "../../support/device.hpp"
#include "../../support/surfels.hpp"
#include "cases.hpp"
#include "diff/traversal/collect_hits.hpp"
#include "hit_comparison.hpp"

namespace relidar::test {

constexpr std::uint32_t kMaxHits = 256;

inline std::vector<reference::Hit> list_hits(const CollectedHits& c, std::size_t ray) {
    std::vector<reference::Hit> hits;
    for (std::uint32_t i = 0; i < std::min(c.counts[ray], c.max_hits); ++i) {
        const std::size_t slot = ray * c.max_hits + i;
        hits.push_back({c.t[slot], c.instance[slot], c.surfel[slot]});
    }
    return hits;
}

/// Converts hits of a scene from to_scene() to the surfel ids of the reference world.
inline CollectedHits convert_to_world(CollectedHits hits, const SceneAndPoses& placed) {
    for (std::size_t ray = 0; ray < hits.counts.size(); ++ray)
        for (std::uint32_t i = 0; i < std::min(hits.counts[ray], hits.max_hits); ++i) {
            std::uint32_t& surfel = hits.surfel[ray * hits.max_hits + i];
            surfel = placed.original.at(surfel);
        }
    return hits;
}

/// Returns the hits of each ray that a test of all surfels on the host finds in float.
inline std::vector<std::vector<reference::Hit>> list_host_hits(const TraversalCase& test_case) {
    const reference::BruteForce brute(to_world(test_case), {}, reference::Precision::float_record);
    std::vector<std::vector<reference::Hit>> hits;
    for (const reference::Ray& ray : to_reference(test_case.rays)) hits.push_back(brute.list_hits(ray));
    return hits;
}

class DeviceHits : public DeviceTest {
protected:
    HitDifferences compare(const TraversalCase& test_case,
                           const std::vector<std::vector<reference::Hit>>& expected,
                           const CollectedHits& actual) {
        const reference::World world = to_world(test_case);
        const std::vector<reference::Ray> rays = to_reference(test_case.rays);
        HitDifferences differences;
        for (std::size_t i = 0; i < rays.size(); ++i) {
            EXPECT_LE(actual.counts[i], kMaxHits) << "the case has more hits than the test keeps";
            compare_hits(world, {}, rays[i], i, expected[i], list_hits(actual, i), differences);
        }
        return differences;
    }

    void expect_equal(const TraversalCase& test_case, const HitDifferences& differences,
                      const std::string& title) {
        EXPECT_EQ(differences.n_errors, 0u) << differences.summary(title) << "\n" << differences.first_error;
        const std::size_t allowed =
            test_case.grazing ? differences.n_rays / 100 : 2 + differences.n_rays / 5000;
        EXPECT_LE(differences.n_different_rays, allowed) << differences.summary(title);
    }
};

}  // namespace relidar::test
