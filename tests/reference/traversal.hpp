// SPDX-License-Identifier: Apache-2.0
// Defines in C++ what a method to find hits must return (docs/architecture.md section 6).
// BruteForce tests every surfel. EmbreeFilter gets candidates from Embree through
// bounding triangles (M3). Both use surfel.hpp, in float (ids comparable with the GPU) or
// in double.
#pragma once

#include <cstdint>
#include <limits>
#include <memory>
#include <tuple>
#include <vector>

#include "surfel.hpp"

namespace relidar::reference {

/// A model (range of surfels) placed in the world.
struct Placement {
    std::uint32_t first = 0;
    std::uint32_t count = 0;
    Pose world_from_model;
    Motion motion = {};
    /// Additional transform of the model in its frame at all times, for finite
    /// differences. The float record ignores this transform.
    Pose change = {};

    Pose at(double time_s) const { return pose_at(world_from_model, motion, time_s) * change; }
    glm::dquat unturned(double time_s) const {
        return world_from_model.rotation * glm::conjugate(pose_at(world_from_model, motion, time_s).rotation);
    }
};

/// All objects that rays can hit. Surfel ids are indices into `surfels`, instance ids are
/// indices into `instances`.
struct World {
    std::vector<Surfel> surfels;
    std::vector<Placement> instances;
};

struct HitKey {
    double t = -std::numeric_limits<double>::infinity();
    std::uint32_t instance = 0;
    std::uint32_t surfel = 0;

    friend bool operator<(const HitKey& a, const HitKey& b) {
        return std::tie(a.t, a.instance, a.surfel) < std::tie(b.t, b.instance, b.surfel);
    }
    friend bool operator==(const HitKey& a, const HitKey& b) {
        return std::tie(a.t, a.instance, a.surfel) == std::tie(b.t, b.instance, b.surfel);
    }
};

using Hit = HitKey;

class HitProvider {
public:
    virtual ~HitProvider() = default;
    /// Replaces `hits` by at most `chunk` (>= 1) hits strictly after `after`, in
    /// ascending order. If it returns fewer than `chunk` hits, no further hits exist.
    virtual void find_next_hits(const Ray& ray, const HitKey& after, int chunk,
                                std::vector<Hit>& hits) const = 0;
};

/// Returns all hits of a ray, fetched `chunk` at a time.
/// @throws std::logic_error if the provider returns too many hits, unsorted hits, or hits
/// that are not behind the previous hits
std::vector<Hit> list_all_hits(const HitProvider& provider, const Ray& ray, int chunk);

enum class Precision { float_record, double_record };

class BruteForce : public HitProvider {
public:
    BruteForce(const World& world, const ImageModel& model, Precision precision);
    void find_next_hits(const Ray& ray, const HitKey& after, int chunk,
                        std::vector<Hit>& hits) const override;

private:
    void collect(const Ray& ray, const HitKey& after, std::vector<Hit>& hits) const;

    ImageModel model_;
    Precision precision_;
    std::vector<Placement> instances_;
    std::vector<FloatRows> rows_;
    std::vector<FloatRecord> float_records_;
    std::vector<DoubleRecord> double_records_;
};

/// Half sizes of the proxy rectangles: k s * scale + pad_m, where k = sqrt(2 ln(sigma /
/// alpha_min)) (M3).
struct ProxyMargin {
    double scale = 1.002;
    double pad_m = 1e-4;
};

/// Computes hits with Embree: two triangles per surfel, a scene per model, an instance
/// geometry per placement, and the canonical function in float. Surfels that are not
/// finite or too transparent have no proxy. Half sizes are limited to 1e5 m.
class EmbreeFilter : public HitProvider {
public:
    EmbreeFilter(const World& world, const ImageModel& model, ProxyMargin margin = {});
    ~EmbreeFilter() override;
    void find_next_hits(const Ray& ray, const HitKey& after, int chunk,
                        std::vector<Hit>& hits) const override;

private:
    struct State;
    std::unique_ptr<State> state_;
};

}  // namespace relidar::reference
