// SPDX-License-Identifier: Apache-2.0
// Computes range, intensity and drop probability of each ray of a sensor from the
// rendered ray (docs/method.md, M6). The drop probability is the probability that the ray
// has no return:
//   drop_prob = 1 - sees (1 - 1 / (1 + exp(hit - drop)))
// hit and drop are the two logits. On an actor, drop contains actor_logit of the beam.
// sees is the probability that the sensor itself does not drop the return. If the ray hit
// nothing within the sensor's range limits, drop_prob is 1. Such a ray never returns,
// because later kernels keep the value 1. The same holds for a ray that hits an actor,
// unless surfaces absorb at least half of its light. So an actor has the same outline,
// whether something is behind it or not. One thread per ray.
// Input: rays, fired, rendered, surfaces, beams, response. Output: measured.
#version 460
#extension GL_GOOGLE_include_directive : require
#include "../../base/kernel.glsl"
#include "../shared/render.h"
RELIDAR_PARAMS(MeasureRaysParams);

const uint kBackgroundInstance = 0u;  // instance of the background

/// Returns the factor of the intensity at a range. Between two entries of the response
/// table, it is a power of the range. Outside the table, it is the first or last factor.
float falloff_at(float range_m) {
    if (params.n_response == 0u) return 1.0;
    vec2 before = params.response.at[0];
    if (range_m < before.x) return before.y;
    for (uint k = 1u; k < params.n_response; ++k) {
        vec2 next = params.response.at[k];
        if (range_m < next.x)
            return before.y * pow(next.y / before.y, log(range_m / before.x) / log(next.x / before.x));
        before = next;
    }
    return before.y;
}

/// Returns the range of a ray for the range image, m. range_kind selects how it is
/// computed. The range offset of the beam is added later.
/// @param heaviest_surface_m range of the surface with the largest weight, m
/// @param normalised_depth_m blended depth / blended weight (D / W), m
float select_range(RenderedRay ray, float heaviest_surface_m, float normalised_depth_m) {
    if (params.range_kind == RELIDAR_RANGE_EXPECTED) return ray.depth;
    if (ray.weight < params.min_weight) return 0.0;
    if (params.range_kind == RELIDAR_RANGE_MODE) return heaviest_surface_m;
    return params.range_kind == RELIDAR_RANGE_MEDIAN && ray.median_depth > 0.0 ? ray.median_depth
                                                                               : normalised_depth_m;
}

float measured_range(float surface_m, SensorBeam beam) {
    return surface_m > 0.0 ? max(surface_m + beam.range_offset_m, 0.0) : surface_m;
}
/// Returns true if a range is within the limits of the sensor. Must give the same result
/// as RangeLimits::contains() on the host.
bool is_within_limits(float range_m) {
    return range_m > 0.0 && range_m >= params.min_range_m && range_m <= params.max_range_m;
}

/// Returns the cosine of the incidence angle between a ray and the blended normal.
/// Returns 0 if the normal is zero.
float incidence(vec3 normal, vec3 direction) {
    float size = length(normal);
    return size > 0.0 ? clamp(-dot(normal, direction) / size, 0.0, 1.0) : 0.0;
}

void main() {
    uint i = thread_index();
    if (i >= params.n_rays) return;
    RenderedRay r = params.rendered.at[i];
    RenderedSurface surface = params.surfaces.at[min(i, params.n_surfaces - 1u)];
    uint channel = params.rays.at[i].channel;
    // Channels without calibration have gain 1 and no offsets.
    SensorBeam beam = SensorBeam(0.0, 1.0, 0.0, 0.0);
    if (channel < params.n_beams) beam = params.beams.at[channel];
    // A median exists only if surfaces absorb at least half of the light.
    bool dominated = r.median_depth > 0.0, is_met = r.weight >= params.min_weight;
    float normalised_depth_m = r.depth / r.weight,
          chosen_m = select_range(r, surface.mode, normalised_depth_m);
    float surface_m = dominated ? r.median_depth : chosen_m;
    MeasuredRay m;
    m.range_m = measured_range(chosen_m, beam);
    m.median_range_m = measured_range(surface_m, beam);
    m.mean_range_m = measured_range(dominated ? normalised_depth_m : surface_m, beam);
    m.intensity =
        clamp(beam.intensity_gain * falloff_at(surface_m) * r.intensity + beam.intensity_offset, 0.0, 1.0);
    // Probability of a return, from the sensor (sees) and from the two logits.
    float drop_logit = r.drop_logit + (r.instance == kBackgroundInstance ? 0.0 : beam.actor_logit);
    float returns = params.rays.at[i].sees * (1.0 - 1.0 / (1.0 + exp(r.hit_logit - drop_logit)));
    // A ray that hits an actor needs a median, so that the outline of the actor does
    // not depend on the surface behind it.
    bool can_return = dominated || (is_met && r.instance == kBackgroundInstance);
    m.drop_prob =
        1.0 -
        (can_return && is_within_limits(m.range_m) && is_within_limits(m.median_range_m) ? returns : 0.0);
    m.weight = r.weight;
    m.incidence = is_met ? incidence(surface.normal, params.fired.at[i].direction) : 0.0;
    m.instance = is_met ? r.instance : RELIDAR_NO_INSTANCE;
    params.measured.at[i] = m;
}
