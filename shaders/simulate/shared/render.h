// SPDX-License-Identifier: Apache-2.0
// Rays of a sensor, and what it makes of what they render.
#ifndef RELIDAR_INCLUDED_SIMULATE_SHARED_RENDER_H
#define RELIDAR_INCLUDED_SIMULATE_SHARED_RENDER_H
#include "relidar/diff/rays.h"

RELIDAR_SHARED_BEGIN

/// A ray of a sensor, in its frame.
struct SensorRay {
    vec3 origin;          // m
    vec3 direction;       // unit
    float time_offset_s;  // when it is fired, from the sweep's reference time
    float sees;           // 1 - probability that the sensor never sees anything along it
    uint channel;         // beam
};
RELIDAR_POINTER(SensorRays, SensorRay);

/// A pose of the sensor in a frame, and how it goes on to the next one.
struct SensorPose {
    vec3 x;  // axes of the sensor
    vec3 y;
    vec3 z;
    vec3 position;        // m
    vec3 position_rest;   // m, what rounding took off `position`
    vec3 way;             // m to the next pose
    vec3 turn;            // rotation vector to the next pose, rad
    float time_offset_s;  // from the sweep's reference time
    float per_s;          // 1 / seconds to the next pose; 0: there is none
};
RELIDAR_POINTER(SensorPoses, SensorPose);

struct FireRaysParams {
    SensorRays rays;    // input [n_rays]
    SensorPoses poses;  // input [n_poses] in ascending order of time
    Rays fired;         // output [n_rays]
    uint n_rays;
    uint n_poses;
};

/// What a beam makes of a surface (Beam in relidar/log/sensor.hpp).
struct SensorBeam {
    float range_offset_m;
    float intensity_gain;
    float intensity_offset;
};
RELIDAR_POINTER(SensorBeams, SensorBeam);

/// A ray of a scan.
struct MeasuredRay {
    float range_m;         // as config.render.range says, 0 where nothing was met
    float median_range_m;  // of the dominant surface; where there is none the same
    float mean_range_m;    // D / W; where no surface dominates that of it
    float intensity;       // 0..1
    float drop_prob;       // M6; 1 where nothing was met within the sensor's limits
    float weight;          // W
    float incidence;       // cosine between the ray and the blended normal, 0 where there is none
    uint instance;         // whose surface was met, or RELIDAR_NO_INSTANCE
};
RELIDAR_POINTER(MeasuredRays, MeasuredRay);

// What the range of a ray is, config.render.range.
#define RELIDAR_RANGE_NORMALISED 0u
#define RELIDAR_RANGE_EXPECTED 1u
#define RELIDAR_RANGE_MODE 2u
#define RELIDAR_RANGE_MEDIAN 3u

struct MeasureRaysParams {
    SensorRays rays;              // input [n_rays]
    Rays fired;                   // input [n_rays] the same in the world
    RenderedRays rendered;        // input [n_rays]
    RenderedGeometries geometry;  // input [n_geometry] as many as rays; one of zeros if none were rendered
    SensorBeams beams;            // input [n_beams]; rays of others measure what is there
    Vec2s response;         // input [n_response] range in m, factor of intensities there; none: 1 everywhere
    MeasuredRays measured;  // output [n_rays]
    uint n_rays;
    uint n_geometry;
    uint n_beams;
    uint n_response;
    uint range_kind;
    float min_weight;  // a ray of less has met nothing
    float min_range_m;
    float max_range_m;
};

// Inputs of a ray-drop network (drop_channel_names() in relidar/diff/network.hpp); an
// origin is three of them: x, y, z.
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
    RELIDAR_OF(Uints, DropChannels) channels;  // input [n_channels] which they are
    RELIDAR_OF(Floats, DropSamples) samples;   // output [n_channels,n_rays]
    vec3 origin;                               // m, of the sensor
    uint n_channels;
    uint n_rays;
};

/// What came back of a ray.
struct ReturnedPoint {
    vec3 position;        // m
    float intensity;      // 0..1
    float time_offset_s;  // of its ray, from the sweep's reference time
    uint ring;            // number of the beam
    uint instance;        // whose surface it is on, or RELIDAR_NO_INSTANCE
};
RELIDAR_POINTER(ReturnedPoints, ReturnedPoint);

struct MarkReturnsParams {
    MeasuredRays measured;  // input [n_rays]
    // input [n_rays] of a network, read where `refined` is 1
    RELIDAR_OF(Floats, DropProbabilities) drop_prob;
    RELIDAR_OF(Uints, ReturnMarks) marks;  // output [n_rays] 1 for rays that return, else 0
    uint n_rays;
    uint refined;
    uint of_image;         // 1: points lie where the image's range says, 0: on the dominant surface
    float drop_threshold;  // a ray that is dropped more likely than this does not return
};

struct GatherPointsParams {
    SensorRays rays;                         // input [n_rays]
    MeasuredRays measured;                   // input [n_rays]
    SensorPoses poses;                       // input [n_poses] of the sensor, in the frame of the points
    RELIDAR_OF(Uints, ReturnMarks) marks;    // input [n_rays]
    RELIDAR_OF(Uints, ReturnPlaces) places;  // input [n_rays] rays before it that return
    ReturnedPoints points;                   // output [rays that return]
    // output [n_asked] ranges of dominant surfaces, of rays k n_rays / n_asked
    RELIDAR_OF(Floats, AskedRanges) asked;
    uint n_rays;
    uint n_poses;
    uint n_asked;  // at most n_rays and 65,536
    uint of_image;
};

RELIDAR_SHARED_END
#endif
