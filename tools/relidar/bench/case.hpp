// SPDX-License-Identifier: Apache-2.0
// What `relidar bench` measures: a benchmark street with its rays, or a trained run seen by its own sensor.
#pragma once

#include <string>

#include <relidar/config.hpp>
#include <relidar/stages/accel.hpp>
#include <relidar/stages/traversal.hpp>

namespace relidar::cli {

/// The case as asked for on the command line.
struct BenchChoice {
    std::string street = "A";         ///< A: surfels of one size however many; B: smaller the more there are; C: as B, all of opacity 0.1
    long long n_surfels = 100000;
    std::string rays = "64x1024";     ///< waymo, kitti or ROWSxCOLUMNS
    std::string run;                  ///< a run folder instead of a street
    std::string chunk, proxy, walk, order, sh, keep_hits;   ///< settings over those of the case; empty = as they are
    std::string distortion, likelihood;              ///< weights of these losses, likewise
    bool deterministic = false;       ///< gradients are gathered, whatever the case says
};

/// A scene, the rays cast into it, and the settings of its kernels.
struct BenchCase {
    std::string name;                 ///< "street A", or the folder of the run and the frame
    Scene scene;
    Config config;
    Proxy proxy = Proxy::automatic;
    Walk walk = Walk::automatic;
    HitOrder order = HitOrder::automatic;
    bool keeps_more_hits = true;      ///< than config.trace.keep_hits, as a training comes to
    WorldRays rays;
    int rows = 0;
    int columns = 0;
    glm::vec3 view_origin_m{0.0f};
    std::vector<InstancePose> placed;   ///< [instances]
};

/// What the device searches, and how, in rendering.
AccelOptions accel_of(const BenchCase& bench);
TraceOptions trace_of(const BenchCase& bench);

/// Looks at every option without making anything. @throws UsageError naming the first one that makes no sense
void check(const BenchChoice& choice);

/// @throws DataError where the run cannot be read
BenchCase make_case(const BenchChoice& choice);

}  // namespace relidar::cli
