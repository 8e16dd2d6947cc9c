// SPDX-License-Identifier: Apache-2.0
// Implements the traversal that all other traversals are compared with
// (docs/architecture.md section 6). Intersects each surfel of each instance with the
// formulas of M1 and M2 and sorts the hits by key.
#include <algorithm>
#include <stdexcept>

#include "traversal.hpp"

namespace relidar::reference {

std::vector<Hit> list_all_hits(const HitProvider& provider, const Ray& ray, int chunk) {
    std::vector<Hit> all, part;
    HitKey after;
    do {
        provider.find_next_hits(ray, after, chunk, part);
        if (int(part.size()) > chunk) throw std::logic_error("all_hits: more hits than asked for");
        for (const Hit& hit : part) {
            if (!(after < hit)) throw std::logic_error("all_hits: hits not strictly ascending");
            after = hit;
            all.push_back(hit);
        }
    } while (int(part.size()) == chunk);
    return all;
}

BruteForce::BruteForce(const World& world, const ImageModel& model, Precision precision)
    : model_(model), precision_(precision), instances_(world.instances) {
    for (const Placement& p : instances_) rows_.push_back(make_model_from_world_rows(p.world_from_model));
    for (const Surfel& s : world.surfels) {
        if (precision == Precision::float_record) float_records_.push_back(make_float_record(s));
        else double_records_.push_back(make_record(s));
    }
}

void BruteForce::collect(const Ray& ray, const HitKey& after, std::vector<Hit>& hits) const {
    const auto offer = [&](const auto& hit, std::uint32_t instance, std::uint32_t surfel) {
        if (!hit) return;
        const Hit key{double(hit->t), instance, surfel};
        if (after < key) hits.push_back(key);
    };
    for (std::uint32_t i = 0; i < instances_.size(); ++i) {
        const Placement& p = instances_[i];
        if (precision_ == Precision::float_record) {
            const LocalRay<float> still = to_model(rows_[i], glm::vec3(ray.origin), glm::vec3(ray.direction));
            const LocalRay<float> local = follow(still, p.world_from_model, p.motion, ray.time_s);
            for (std::uint32_t s = p.first; s < p.first + p.count; ++s)
                offer(intersect_in_float(float_records_[s], local, model_), i, s);
        } else {
            const LocalRay<double> local = to_model(p.at(ray.time_s), ray);
            for (std::uint32_t s = p.first; s < p.first + p.count; ++s)
                offer(intersect_in_double(double_records_[s], local, model_), i, s);
        }
    }
}

void BruteForce::find_next_hits(const Ray& ray, const HitKey& after, int chunk,
                                std::vector<Hit>& hits) const {
    hits.clear();
    collect(ray, after, hits);
    const std::size_t n_returned_hits = std::min(hits.size(), std::size_t(chunk));
    std::partial_sort(hits.begin(), hits.begin() + std::ptrdiff_t(n_returned_hits), hits.end());
    hits.resize(n_returned_hits);
}

}  // namespace relidar::reference
