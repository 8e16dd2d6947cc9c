// SPDX-License-Identifier: Apache-2.0
// Rays of a sensor and their measurements.
#ifndef RELIDAR_INCLUDED_SIMULATE_SHARED_RENDER_H
#define RELIDAR_INCLUDED_SIMULATE_SHARED_RENDER_H
#include "relidar/diff/rays.h"
#include "relidar/simulate/returned_point.h"

RELIDAR_SHARED_BEGIN

struct SensorRay {
    vec3 origin;          // m
    vec3 direction;       // unit vector
    float time_offset_s;  // firing time relative to the sweep's reference time
    // Probability that the sensor reports a return from this direction. It does not
    // depend on the scene. It is less than 1 where, for example, the vehicle blocks rays.
    float sees;
    uint channel;  // beam number
};
RELIDAR_DECLARE_POINTER(SensorRays, SensorRay);

struct SensorPose {
    vec3 x;  // axes of the sensor
    vec3 y;
    vec3 z;
    vec3 position;        // m
    vec3 position_rest;   // m, rounding error of `position`
    vec3 move_to_next;    // translation to the next pose, m
    vec3 turn_to_next;    // rotation vector to the next pose, rad
    float time_offset_s;  // relative to the sweep's reference time
    float per_s;          // Inverse of the time to the next pose, 1/s. 0 for the last pose.
};
RELIDAR_DECLARE_POINTER(SensorPoses, SensorPose);

struct FireRaysParams {
    SensorRays rays;    // input [n_rays]
    SensorPoses poses;  // input [n_poses] in ascending order of time
    Rays fired;         // output [n_rays]
    uint n_rays;
    uint n_poses;
};

/// Calibration of a beam (Beam in relidar/log/sensor.hpp).
struct SensorBeam {
    float range_offset_m;
    float intensity_gain;
    float intensity_offset;
    float actor_logit;  // added to the drop logit of a ray that hits an actor
};
RELIDAR_DECLARE_POINTER(SensorBeams, SensorBeam);

struct MeasuredRay {
    float range_m;  // Range of the type that config.render.range selects. 0 if the ray hit nothing.
    // Median range, m: distance at which the transmittance of the ray falls to 0.5. Equal
    // to the field range_m if the transmittance stays above 0.5.
    float median_range_m;
    // Mean range, m: D / W (blended depth / blended weight). If the transmittance stays
    // above 0.5, no surface dominates the ray, and this is a copy of range_m.
    float mean_range_m;
    float intensity;  // 0..1
    // Probability that the ray has no return. 1 if the ray hit nothing within the
    // sensor's limits, or an actor with less than half of its light.
    float drop_prob;
    float weight;  // W
    // Cosine of the angle between ray and blended normal. 0 if the hit has no normal.
    float incidence;
    uint instance;  // instance that was hit, or RELIDAR_NO_INSTANCE
};
RELIDAR_DECLARE_POINTER(MeasuredRays, MeasuredRay);

#define RELIDAR_RANGE_NORMALISED 0u
#define RELIDAR_RANGE_EXPECTED 1u
#define RELIDAR_RANGE_MODE 2u
#define RELIDAR_RANGE_MEDIAN 3u

struct MeasureRaysParams {
    SensorRays rays;            // input [n_rays]
    Rays fired;                 // input [n_rays] the same rays in the world frame
    RenderedRays rendered;      // input [n_rays]
    RenderedSurfaces surfaces;  // Input [n_surfaces]: surface that each ray hit, or one entry of zeros.
    // Input [n_beams]: calibration by beam number. Beams without an entry have offsets of
    // 0 and the gain 1.
    SensorBeams beams;
    // Input [n_response]: pairs of range in m and intensity factor. The factor is 1 if
    // the array is empty.
    Vec2s response;
    MeasuredRays measured;  // output [n_rays]
    uint n_rays;
    uint n_surfaces;
    uint n_beams;
    uint n_response;
    uint range_kind;
    // Minimum blended weight. A ray with a smaller weight has hit nothing.
    float min_weight;
    float min_range_m;
    float max_range_m;
};

// Indices of the input channels of the ray-drop network. The ray origin takes three
// channels: x, y, z.
#define RELIDAR_DROP_LOG_RANGE 0u
#define RELIDAR_DROP_INTENSITY 1u
#define RELIDAR_DROP_LOGIT 2u
#define RELIDAR_DROP_WEIGHT 3u
#define RELIDAR_DROP_SPREAD 4u
#define RELIDAR_DROP_COSINE 5u
#define RELIDAR_DROP_ELEVATION 6u
#define RELIDAR_DROP_ORIGIN 7u

struct DropChannelsParams {
    SensorRays rays;                           // input [n_rays]
    MeasuredRays measured;                     // input [n_rays]
    RELIDAR_OF(Uints, DropChannels) channels;  // input [n_channels] indices of the channels
    RELIDAR_OF(Floats, DropSamples) samples;   // output [n_channels,n_rays]
    vec3 origin;                               // position of the sensor, m
    uint n_channels;
    uint n_rays;
};

struct MarkReturnsParams {
    MeasuredRays measured;  // input [n_rays]
    // Input [n_rays]: drop probabilities from the network. Used if `has_network` is 1.
    RELIDAR_OF(Floats, DropProbabilities) drop_prob;
    RELIDAR_OF(Uints, ReturnMarks) marks;  // output [n_rays] 1 for rays with a return, otherwise 0
    uint n_rays;
    uint has_network;
    // Selects the distance of a returned point along its ray. 1: MeasuredRay::range_m, as
    // in the range image. 0: MeasuredRay::median_range_m.
    uint use_image_range;
    // A ray has no return if its drop probability reaches this threshold.
    float drop_threshold;
};

struct GatherPointsParams {
    SensorRays rays;        // input [n_rays]
    MeasuredRays measured;  // input [n_rays]
    SensorPoses poses;      // Input [n_poses]: poses of the sensor, in the frame of the output points.
    RELIDAR_OF(Uints, ReturnMarks) marks;  // input [n_rays]
    // Input [n_rays]: number of earlier rays with a return.
    RELIDAR_OF(Uints, ReturnPlaces) point_index;
    ReturnedPoints points;  // output [number of returned rays]
    // Output [n_sampled]: median ranges of evenly spaced rays. Entry k is the range of
    // ray k * n_rays / n_sampled, rounded down.
    RELIDAR_OF(Floats, RequestedRanges) sampled_m;
    uint n_rays;
    uint n_poses;
    uint n_sampled;  // at most n_rays and 65,536
    uint use_image_range;
};

RELIDAR_SHARED_END
#endif
