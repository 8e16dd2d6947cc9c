// SPDX-License-Identifier: Apache-2.0
// Table of all settings, from which keys, `--set`, TOML files and `--help` are generated.
// Only the presets can set a field of <relidar/run/config.hpp> without a row. Loss
// weights have a separate table. Private to config.
#pragma once

#include <limits>
#include <string>
#include <vector>

#include <relidar/log/channels.hpp>
#include <relidar/run/config.hpp>

namespace relidar::config {

/// a range of numbers, or a list of texts
struct SettingValueRange {
    double low = std::numeric_limits<double>::lowest();
    double high = std::numeric_limits<double>::max();
    /// the value must be greater than `low`, not equal
    bool above_low = false;
    /// For an enum, the index of a text is the value of the enum.
    std::vector<std::string> choices = {};
    bool several = false;  ///< true if the value may contain several choices, separated by commas
};

inline SettingValueRange accept_anything() { return {}; }
inline SettingValueRange accept_at_least(double minimum) { return {.low = minimum}; }
inline SettingValueRange accept_above(double exclusive_minimum) {
    return {.low = exclusive_minimum, .above_low = true};
}
inline SettingValueRange accept_between(double minimum, double maximum) {
    return {.low = minimum, .high = maximum};
}
inline SettingValueRange accept_one_of(std::vector<std::string> choices) {
    return {.choices = std::move(choices)};
}
inline SettingValueRange accept_some_of(std::vector<std::string> choices) {
    return {.choices = std::move(choices), .several = true};
}

inline std::vector<std::string> primitive_names() {
    std::vector<std::string> names;
    for (const PrimitiveProperties& kind : kPrimitives) names.emplace_back(kind.name);
    return names;
}

struct SettingHelp {
    const char* text;
    bool expert = false;  ///< true if only users who know the implementation need the setting
    SettingHelp(const char* words, bool is_expert = false) : text(words), expert(is_expert) {}
};
inline SettingHelp mark_expert(const char* help_text) { return {help_text, true}; }

inline constexpr double kMaxCount = 2147483647.0;
// 2^53; up to this value, a double represents every integer exactly
inline constexpr double kMaxSeed = 9007199254740992.0;

/// Calls visitor(key, field, accepted values, help) for each setting, in the order of the
/// TOML file.
template <class C, class Visitor>
void visit_settings(C& config, Visitor&& visitor) {
#define RELIDAR_SETTING(member, accepts, help) visitor(#member, config.member, accepts, help)
    RELIDAR_SETTING(
        preset, accept_one_of({"paper", "released", "default", "quick"}),
        "name of the preset that sets all values; setting the preset overwrites all other settings");
    RELIDAR_SETTING(dataset.path, accept_anything(),
                    "path of the log, or KIND:PATH to set the kind of the dataset; training stores it in the "
                    "settings of the run");
    RELIDAR_SETTING(dataset.sequence, accept_anything(),
                    "name of the drive if the dataset contains several; empty: the first drive");
    RELIDAR_SETTING(dataset.lidars, accept_anything(),
                    "names of the LiDARs to read, separated by commas; empty: all LiDARs of the log");
    RELIDAR_SETTING(dataset.frames_begin, accept_between(0, kMaxCount),
                    "number of the first frame to read, in the numbering of the dataset");
    RELIDAR_SETTING(dataset.frames_end, accept_between(-1, kMaxCount),
                    "number of the frame after the last frame to read; -1: read to the end of the log");
    RELIDAR_SETTING(dataset.test_every, accept_between(0, kMaxCount),
                    "N: every Nth frame is held out for testing; 0: no frame is held out");
    RELIDAR_SETTING(dataset.test_frames, accept_anything(),
                    "frames that are held out for testing, in the numbering of the dataset, for example "
                    "13,26,40:45, where 40:45 excludes 45; empty: use dataset.test_every");
    RELIDAR_SETTING(
        dataset.poses, accept_anything(),
        "text file with the poses of the vehicle, or of the LiDAR if the log has no mounting. Each line has "
        "12 numbers (a 3 x 4 matrix by rows), or time_s x y z qw qx qy qz, or time_s x y z roll pitch yaw in "
        "radians; empty: use the poses of the dataset; none: estimate the poses from the scans");
    RELIDAR_SETTING(
        dataset.poses_from, accept_anything(),
        "for a ROS bag, the source of the LiDAR's poses: a frame of /tf, such as map or odom, or a topic "
        "with odometry or poses; empty: chosen automatically, and `relidar info` prints the choice");
    RELIDAR_SETTING(
        dataset.skip_broken, accept_anything(),
        "skip scans that cannot be read, and print a note for each; false: the first such scan is an error");
    RELIDAR_SETTING(dataset.min_range_m, accept_at_least(0),
                    "minimum range in metres; nearer returns of the log count as dropped, and the simulated "
                    "sensor of the log returns nothing nearer");
    RELIDAR_SETTING(dataset.max_range_m, accept_at_least(0),
                    "maximum range in metres; farther returns count as dropped, both in the log and in "
                    "simulated scans of its sensor; 0: the limit of the sensor, or the farthest return of "
                    "the log if this limit is unknown");
    RELIDAR_SETTING(
        dataset.waymo_intensity, accept_one_of({"tanh", "clamp"}),
        mark_expert("how intensities of Waymo Open, which have no upper limit, are mapped to the range from "
                    "0 to 1: tanh: by the function tanh; clamp: values above 1 become 1"));
    RELIDAR_SETTING(dataset.memory_mib, accept_between(0, kMaxCount),
                    "memory for scans in MiB; further scans are stored in a memory-mapped file in TMPDIR; 0: "
                    "half of the machine's memory");
    RELIDAR_SETTING(conventions.deskew, accept_one_of({"auto", "raw", "deskewed"}),
                    "whether the points of the log are raw, at their firing times, or deskewed "
                    "(motion-compensated); auto, here and below: as the log says it, or guessed");
    RELIDAR_SETTING(conventions.time_unit, accept_one_of({"auto", "s", "ms", "us", "ns"}),
                    "unit of the times of points");
    RELIDAR_SETTING(conventions.time_zero, accept_one_of({"auto", "stamp", "clock", "first_point"}),
                    "when the time of a point is 0: stamp: at the time stamp of its scan; clock: at the zero "
                    "of the clock of the stamps; first_point: unknown, so the first point gets the stamp");
    RELIDAR_SETTING(conventions.clock_offset_s, accept_anything(),
                    "seconds by which the clock of the scans is ahead of the clock of the poses, for example "
                    "37 for TAI and UTC; or auto");
    RELIDAR_SETTING(conventions.intensity_max, accept_at_least(0),
                    "intensity in the files that becomes 1; 0: as the log says it, or guessed");
    RELIDAR_SETTING(conventions.poses, accept_one_of({"auto", "world_from_sensor", "sensor_from_world"}),
                    "what the poses of the log are; sensor_from_world is the inverse of the usual poses");
    RELIDAR_SETTING(conventions.quaternions, accept_one_of({"auto", "wxyz", "xyzw"}),
                    "order of the quaternions of poses");
    RELIDAR_SETTING(conventions.angles, accept_one_of({"auto", "radians", "degrees"}),
                    "unit of roll, pitch and yaw in a file of poses");
    RELIDAR_SETTING(conventions.rings, accept_one_of({"auto", "highest_first", "lowest_first"}),
                    "beam that has the ring 0");
    RELIDAR_SETTING(conventions.box_origin, accept_one_of({"auto", "centre", "bottom"}),
                    "position of a box: its centre, or the centre of its bottom side");
    RELIDAR_SETTING(
        conventions.box_axes,
        accept_one_of({"auto", "right", "swapped", "turned", "mirrored_world", "mirrored_vehicle"}),
        "how boxes are stored: right: length along x, in right-handed axes; swapped: width before length; "
        "turned: 90 degrees of yaw are missing; mirrored_world, mirrored_vehicle: y and yaw have the "
        "opposite sign in the world or in the frame of the vehicle, as in CARLA");
    RELIDAR_SETTING(sensor.grid, accept_one_of({"native", "kitti360"}),
                    "pixel grid of the range images that are rendered and scored: the rows and columns of "
                    "the sensor (native), or the grid of KITTI-360 with 66 x 1030 pixels (kitti360)");
    RELIDAR_SETTING(
        sensor.grid_method, accept_one_of({"project", "cast"}),
        mark_expert(
            "how images on the KITTI-360 grid are made: project: simulate the native scan and project its "
            "points onto the pixels; cast: cast one ray through the centre of each pixel"));
    RELIDAR_SETTING(
        sensor.rolling_shutter, accept_one_of({"auto", "true", "false"}),
        "each ray of a rendered scan starts at the position that the sensor has when it fires the ray; auto: "
        "off for the sensor of the log if the scans of the log are motion-compensated, otherwise on");
    RELIDAR_SETTING(
        sensor.calibrate, accept_one_of({"none", "range", "intensity", "range,intensity"}),
        "quantities that are calibrated for each beam from the training scans: the offset of its ranges, "
        "which differ by centimetres between beams, and the gain and offset of its intensities");
    RELIDAR_SETTING(sensor.sub_rays, accept_between(1, 9),
                    "number of rays that are cast per simulated beam to sample its footprint: 1, 5 or 9; "
                    "their hits are combined into returns like in a LiDAR receiver");
    RELIDAR_SETTING(
        sensor.divergence_mrad, accept_between(0, 100),
        "full beam divergence of the simulated sensor in milliradians; 0: the value of the sensor");
    RELIDAR_SETTING(sensor.returns, accept_between(1, 2),
                    "number of simulated returns per ray; 2 needs sensor.sub_rays of 5 or 9, and gives the "
                    "strongest and the last return, or the second strongest if the last is the strongest");
    RELIDAR_SETTING(sensor.return_separation_m, accept_above(0),
                    mark_expert("hits of a beam merge into one return if their ranges differ by less than "
                                "this distance in metres"));
    RELIDAR_SETTING(init.voxel_m, accept_above(0),
                    "edge length in metres of the voxels in which the points of all training frames are "
                    "averaged to initialise surfels");
    RELIDAR_SETTING(init.voxel_growth, accept_at_least(0),
                    mark_expert("increase of the voxel edge length per metre of distance from the nearest "
                                "sensor position; 0: all voxels have the same size (as in the paper)"));
    RELIDAR_SETTING(init.normals, accept_anything(),
                    mark_expert("orient new surfels by normals that are estimated from the nearest "
                                "neighbouring points; false: random orientations"));
    RELIDAR_SETTING(
        init.unlabelled_movers, accept_one_of({"background", "removed", "actors"}),
        "how moving objects without a labelled box are handled: background: they are part of the background "
        "(as in the paper); removed: their points are removed where other training frames observe free "
        "space; actors: they are removed from the background, and each becomes an actor with a new track");
    RELIDAR_SETTING(init.scale_factor, accept_above(0),
                    mark_expert("ratio of the standard deviation of a new surfel to the mean distance to its "
                                "3 nearest neighbours"));
    RELIDAR_SETTING(init.max_gap_m, accept_at_least(0),
                    mark_expert("new surfels are elongated to close gaps between scan lines of up to this "
                                "width in metres; 0: all new surfels are round (as in the paper)"));
    RELIDAR_SETTING(init.actor_classes, accept_anything(),
                    "classes whose moving boxes become actors, separated by commas: vehicle, cyclist, "
                    "person, other, or a class name of the dataset; all: every class; empty: no class; see "
                    "init.mask_others for the other boxes");
    RELIDAR_SETTING(
        init.mask_others, accept_anything(),
        mark_expert("ignore points and losses inside moving boxes whose class is not in init.actor_classes; "
                    "false: these boxes are part of the background (as in the paper)"));
    RELIDAR_SETTING(
        init.actor_tracks, accept_anything(),
        mark_expert(
            "ids of tracks that become actors, even if they are parked or of another class, separated by "
            "commas; other labelled tracks then become no actors; empty: init.actor_classes decides"));
    RELIDAR_SETTING(
        init.deform, accept_anything(),
        "classes whose actors change their shape while they walk, separated by commas: vehicle, cyclist, "
        "person, other, or a class name of the dataset; empty: all actors are rigid (as in the paper)");
    RELIDAR_SETTING(init.actor_pad_to, accept_between(0, 1e6),
                    mark_expert("add random points inside the box of an actor until the actor has this "
                                "number of points; 0: add no points; value in the paper: 8000"));
    RELIDAR_SETTING(init.actor_min_points, accept_between(10, 1e6),
                    mark_expert("minimum number of points of an actor; points and losses in boxes with fewer "
                                "points are ignored"));
    RELIDAR_SETTING(image.alpha_min, accept_between(1e-6, 0.5),
                    mark_expert("minimum alpha at the edge of a surfel (value in the paper: 1/255); larger "
                                "values make surfels smaller, so that rays hit fewer of them"));
    RELIDAR_SETTING(
        image.transmittance_min, accept_between(0, 0.5),
        mark_expert("a ray stops before the surfel that would reduce its transmittance below this value; "
                    "must be less than 0.01, otherwise opaque surfels are never rendered"));
    RELIDAR_SETTING(image.sh_degree, accept_between(0, 3),
                    "degree of the spherical harmonics, which describe how intensity and ray-drop of a "
                    "surfel depend on the direction");
    RELIDAR_SETTING(
        image.sh_direction, accept_one_of({"ray", "surfel"}),
        mark_expert("direction in which spherical harmonics are evaluated: ray: along the ray, for each hit; "
                    "surfel: from the sensor to the mean of the surfel, once per surfel"));
    RELIDAR_SETTING(
        image.single_drop_logit, accept_anything(),
        mark_expert("compute the ray-drop probability of a ray as the sigmoid of one blended logit; false: "
                    "as the softmax of a drop logit and a hit logit (as in the paper)"));
    RELIDAR_SETTING(image.primitive, accept_one_of(primitive_names()),
                    mark_expert("primitives of the scene: flat 2D Gaussians (as in the paper) or 3D "
                                "Gaussians; ray query traces 3D Gaussians as icosahedra of triangles"));
#define RELIDAR_TERM(index, name, setting, standard, accepts, meaning) \
    visitor("loss." #setting, config.loss.setting, accepts, meaning);
    RELIDAR_LOSS_TERMS(RELIDAR_TERM)
#undef RELIDAR_TERM
    RELIDAR_SETTING(loss.normalised_depth, accept_anything(),
                    mark_expert("the range loss compares the normalised range D / W, where D is the blended "
                                "range and W the sum of weights; false: it compares D (as in the paper)"));
    RELIDAR_SETTING(train.iterations, accept_between(0, kMaxCount),
                    "number of optimiser steps; 0: the scene is not trained after its initialisation");
    RELIDAR_SETTING(train.grid, accept_one_of({"native", "kitti360"}),
                    mark_expert("rays of a training frame: the rays as fired (native), or one ray per pixel "
                                "of the KITTI-360 grid with 66 x 1030 pixels (kitti360, as in the paper)"));
    RELIDAR_SETTING(train.rays_per_iteration, accept_between(0, kMaxCount),
                    "number of rays per optimiser step; 0: all rays of one frame");
    RELIDAR_SETTING(train.sh_degree_interval, accept_between(1, kMaxCount),
                    mark_expert("number of steps after which the degree of the spherical harmonics that "
                                "training uses increases by one"));
    RELIDAR_SETTING(train.only_touched, accept_anything(),
                    mark_expert("surfels without a gradient in a step keep their values and Adam moments; "
                                "false: all surfels are updated in each step"));
    RELIDAR_SETTING(
        train.deterministic, accept_anything(),
        "sum gradients in a fixed order, so that repeated runs on one device give bit-identical parameters");
    RELIDAR_SETTING(train.sensor_drop, accept_anything(),
                    mark_expert("learn a map of the rays that the sensor never receives, for example because "
                                "the vehicle blocks them; this map is separate from the scene"));
    RELIDAR_SETTING(train.refine_poses, accept_one_of({"none", "sensor", "actors", "sensor,actors"}),
                    "poses that training refines together with the scene: the poses of the sensor and of the "
                    "actors' boxes");
    RELIDAR_SETTING(
        train.allow_lost_scans, accept_anything(),
        "train even if more than 5 % of the scans of a log without poses could not be registered; false: "
        "this is an error");
    RELIDAR_SETTING(train.frame_memory_mib, accept_between(0, kMaxCount),
                    mark_expert("device memory in MiB for the rays and targets of frames; frames that do not "
                                "fit are uploaded again for each step that uses them"));
    RELIDAR_SETTING(train.log_every, accept_between(1, kMaxCount),
                    "number of steps between two lines in log.jsonl");
    RELIDAR_SETTING(
        train.checkpoint_minutes, accept_at_least(0),
        "minutes between two checkpoints; 0: write a checkpoint only if Ctrl-C interrupts training");
    RELIDAR_SETTING(train.seed, accept_between(0, kMaxSeed),
                    "random seed of the initialisation and of the order of frames and rays");
    RELIDAR_SETTING(blocks.length_m, accept_between(0, 1e6),
                    "maximum length in metres of a block of the trajectory; a long log is trained block by "
                    "block; 0: train the log as one piece");
    RELIDAR_SETTING(densify.strategy, accept_one_of({"none", "adaptive"}),
                    "how training adds and removes surfels; adaptive: by their gradients (as in the paper)");
    RELIDAR_SETTING(refine.enabled, accept_anything(),
                    "after the scene, train a network that corrects the ray-drop of rendered scans (paper, "
                    "Eq. 12-13), and use it for rendering if the run has one");
    RELIDAR_SETTING(
        refine.network, accept_one_of({"small", "paper", "pixel"}),
        "type of the ray-drop network: small: a U-Net with 8 channels and 3 levels; paper: a U-Net with 32 "
        "channels, 4 levels and attention; pixel: a network that processes each pixel independently");
    RELIDAR_SETTING(refine.image, accept_one_of({"native", "grid"}),
                    mark_expert("image that the ray-drop network reads: native: the image of the sensor's "
                                "rays; grid: the image on the pixel grid of sensor.grid"));
    RELIDAR_SETTING(refine.rays, accept_one_of({"none", "direction", "origin,direction"}),
                    mark_expert("additional inputs of the ray-drop network: direction: the elevation of each "
                                "ray; origin: the position of the sensor; the paper uses both"));
    RELIDAR_SETTING(refine.frames, accept_at_least(0),
                    mark_expert("maximum number of training frames that the ray-drop network is trained on, "
                                "evenly distributed over the log; 0: all"));
    RELIDAR_SETTING(refine.epochs, accept_between(1, 100000),
                    "number of epochs of the ray-drop network, which are passes over its training frames");
    RELIDAR_SETTING(
        refine.rate, accept_above(0),
        mark_expert(
            "initial learning rate of the ray-drop network; it decreases to one hundredth of this value"));
    RELIDAR_SETTING(
        render.range, accept_one_of({"expected", "normalised", "median", "mode"}),
        mark_expert(
            "range of a ray in range images; \"expected\": the blended range D (as in the paper); "
            "\"normalised\": D / W, where W is the sum of the weights; \"median\": the range at which the "
            "transmittance falls below 0.5; \"mode\": the mean range of the surface with the largest weight "
            "(hits closer together than sensor.return_separation_m form one surface)"));
    RELIDAR_SETTING(
        render.channels, accept_some_of(optional_names()),
        "additional channels of scans, in all output files; `relidar render --help` describes them");
    RELIDAR_SETTING(render.points, accept_one_of({"median", "range"}),
                    mark_expert("range of points in point clouds: median: where the transmittance falls "
                                "below 0.5, so that each point is on a surface; range: the range that "
                                "render.range selects, which can be between two surfaces"));
    RELIDAR_SETTING(render.memory_mib, accept_between(0, kMaxCount),
                    "device memory in MiB for blocks of a long scene that the current scan does not need; "
                    "they are kept for later scans");
    RELIDAR_SETTING(
        trace.chunk, accept_between(1, 64),
        mark_expert("maximum number of hits that a ray collects and sorts in one traversal of the scene"));
    RELIDAR_SETTING(trace.keep_hits, accept_between(0, 4096),
                    mark_expert("number of hits per ray, 16 bytes each, that training stores so that the "
                                "backward pass needs no second traversal; it is doubled up to 256 if a ray "
                                "has more hits; 0: traverse again (as in the paper)"));
#undef RELIDAR_SETTING
}

}  // namespace relidar::config
