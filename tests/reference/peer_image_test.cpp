// SPDX-License-Identifier: Apache-2.0
// Compares the reference with an image that the official implementation rendered on a GPU
// (../shared/bench, street(100000) with rays("kitti")): M1-M5 with SH along the ray.
#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <cstdio>
#include <cstdlib>
#include <filesystem>

#include <relidar/base/arrays.hpp>
#include <relidar/scene/scene.hpp>
#include "scene/benchmark_street.hpp"

#include "../support/surfels.hpp"
#include "../support/tolerances.hpp"
#include "render.hpp"

namespace relidar::reference {
namespace {

std::filesystem::path get_shared_folder() {
    if (const char* folder = std::getenv("RELIDAR_SHARED")) return folder;
    return std::filesystem::path(__FILE__).parent_path().parent_path().parent_path().parent_path() / "shared";
}

struct PeerImage {
    std::vector<float> directions, depth, intensity, hit_logit, drop_logit, weight, transmittance;

    explicit PeerImage(const std::filesystem::path& path) {
        for (const NamedArray& array : read_npz(path)) {
            const std::pair<const char*, std::vector<float>*> named_members[] = {
                {"dirs", &directions},     {"depth", &depth},           {"intensity", &intensity},
                {"hit_logit", &hit_logit}, {"drop_logit", &drop_logit}, {"weight", &weight},
                {"T", &transmittance}};
            for (const auto& [name, values] : named_members)
                if (array.name == name) *values = array.to_floats();
        }
    }
};

struct Differences {
    double depth_m = 0.0, channel = 0.0;
    int outliers = 0;

    void add(const Pixel& pixel, const PeerImage& peer, std::size_t index) {
        const double depth_error = std::abs(pixel.depth - double(peer.depth[index]));
        double channel_error = 0.0;
        for (const auto& [mine, theirs] : {std::pair{pixel.intensity, peer.intensity[index]},
                                           std::pair{pixel.hit_logit, peer.hit_logit[index]},
                                           std::pair{pixel.drop_logit, peer.drop_logit[index]},
                                           std::pair{pixel.weight, peer.weight[index]},
                                           std::pair{pixel.transmittance, peer.transmittance[index]}})
            channel_error = std::max(channel_error, std::abs(mine - double(theirs)));
        if (depth_error > test::kPeerDepth_m || channel_error > test::kPeerChannel) {
            ++outliers;
            std::printf("  ray %zu: depth differs by %.3e m, channels by %.3e\n", index, depth_error,
                        channel_error);
            return;
        }
        depth_m = std::max(depth_m, depth_error);
        channel = std::max(channel, channel_error);
    }
};

class PeerImageTest : public ::testing::Test {
protected:
    void SetUp() override {
        path = get_shared_folder() / "bench" / "peer_render_A100k_kitti.npz";
        if (!std::filesystem::exists(path)) GTEST_SKIP() << path << " is not there";
        surfels = test::to_reference(make_street_surfels(100000));
        world = {surfels, {{0, std::uint32_t(surfels.size()), {}}}};
    }

    Differences compare(const PeerImage& peer, std::size_t stride) const {
        const BruteForce brute(world, {}, Precision::double_record);
        const std::vector<Ray> rays = test::to_reference(test::to_world_rays(make_street_rays("kitti")));
        Differences differences;
        for (std::size_t i = 17; i < rays.size(); i += stride) {
            for (int axis = 0; axis < 3; ++axis)
                EXPECT_EQ(float(rays[i].direction[axis]), peer.directions[3 * i + std::size_t(axis)]);
            differences.add(render(world, brute, Settings{}, rays[i]), peer, i);
        }
        std::printf("  largest difference: depth %.3e m, channels %.3e, outliers %d\n", differences.depth_m,
                    differences.channel, differences.outliers);
        return differences;
    }

    std::filesystem::path path;
    std::vector<Surfel> surfels;
    World world;
};

TEST_F(PeerImageTest, DoubleBruteForceOn200Rays) {
    const Differences d = compare(PeerImage(path), 339);
    EXPECT_LE(d.outliers, 1);  // these rays have no expected outlier
    EXPECT_GT(d.depth_m, 0.0) << "nothing was compared";
}

}  // namespace
}  // namespace relidar::reference
