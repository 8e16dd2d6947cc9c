// SPDX-License-Identifier: Apache-2.0
// Table of all settings: key, value, accepted values, description. Keys, `--set`, TOML
// files and `--help` are generated from this table. To add a setting, add a field in
// <relidar/run/config.hpp> and a row in this table. A field without a row is a constant
// whose value only the presets set. Loss weights have a separate table. Private to
// config.
#pragma once

#include <limits>
#include <string>
#include <type_traits>
#include <vector>

#include <relidar/log/channels.hpp>
#include <relidar/run/config.hpp>

namespace relidar::config_detail {

/// Values that a setting accepts: a range of numbers, or a list of texts.
struct Accepts {
    double low = std::numeric_limits<double>::lowest();
    double high = std::numeric_limits<double>::max();
    /// True: the value must be greater than `low`. False: the value may equal `low`.
    bool above_low = false;
    /// Accepted texts. An enum value is stored as the index of its text in this list.
    std::vector<std::string> choices;
    bool several = false;  ///< True: the value may contain several of the choices, separated by commas.
};

inline Accepts anything() { return {}; }
inline Accepts at_least(double low) { return {low, std::numeric_limits<double>::max(), false, {}}; }
inline Accepts above(double low) { return {low, std::numeric_limits<double>::max(), true, {}}; }
inline Accepts between(double low, double high) { return {low, high, false, {}}; }
inline Accepts one_of(std::vector<std::string> names) {
    Accepts accepts;
    accepts.choices = std::move(names);
    return accepts;
}

inline std::vector<std::string> primitive_names() {
    std::vector<std::string> names;
    for (const PrimitiveKind& kind : kPrimitives) names.emplace_back(kind.name);
    return names;
}

inline Accepts some_of(std::vector<std::string> names) {
    Accepts accepts = one_of(std::move(names));
    accepts.several = true;
    return accepts;
}

/// Description of a setting, and whether it is for experts.
struct Help {
    const char* text;
    bool expert = false;  ///< True: the setting is only useful for users who know the implementation.
    Help(const char* words, bool is_expert = false) : text(words), expert(is_expert) {}
};
inline Help expert(const char* text) { return {text, true}; }

inline constexpr double kMaxCount = 2147483647.0;
// Maximum seed, 2^53. A TOML integer and a double can both store integers exactly up to
// this value.
inline constexpr double kMaxSeed = 9007199254740992.0;

template <class C, class Visitor>
void visit_dataset(C& c, Visitor&& f) {
    f("dataset.path", c.dataset.path, anything(), "dataset: a path, or kind:path; training fills it in");
    f("dataset.sequence", c.dataset.sequence, anything(),
      "which drive of a dataset that holds several, by its own name; empty: the only one, or the first");
    f("dataset.lidars", c.dataset.lidars, anything(),
      "names of the LiDARs that are read of a log with several, separated by commas; empty: all");
    f("dataset.frames_begin", c.dataset.frames_begin, between(0, kMaxCount),
      "first frame, by the dataset's own number");
    f("dataset.frames_end", c.dataset.frames_end, between(-1, kMaxCount),
      "frame after the last one; -1: to the end of the log");
    f("dataset.test_every", c.dataset.test_every, between(0, kMaxCount),
      "every so many frames one is held out for testing; 0: none");
    f("dataset.test_frames", c.dataset.test_frames, anything(),
      "frames that are held out for testing, by the dataset's own numbers, ends of ranges not included, as "
      "in 13,26,40:45; empty: "
      "dataset.test_every decides");
    f("dataset.poses", c.dataset.poses, anything(),
      "file with 12 numbers a line, world_from_sensor of each frame; empty: the dataset's own poses; none: "
      "no poses, they are found from "
      "the scans alone");
    f("dataset.poses_from", c.dataset.poses_from, anything(),
      "of a ROS bag: frame of /tf, such as map or odom, or topic of odometry or poses that says where the "
      "LiDAR was; empty: guessed, info "
      "says what is used");
    f("dataset.skip_broken", c.dataset.skip_broken, anything(),
      "leave scans that cannot be read out, with a note each; false: the first of them is an error");
    f("dataset.min_range_m", c.dataset.min_range_m, at_least(0),
      "returns nearer than this count as dropped, and the log's sensor simulates none there, metres");
    f("dataset.max_range_m", c.dataset.max_range_m, at_least(0),
      "returns beyond this range count as dropped, and the log's sensor simulates none there, metres; 0: the "
      "sensor's own limit, or the "
      "log's farthest return if that is not known");
    f("dataset.waymo_intensity", c.dataset.waymo_intensity, one_of({"tanh", "clamp"}),
      expert("intensities of Waymo Open, which have no upper end: their tanh, or cut at 1"));
    f("dataset.memory_mib", c.dataset.memory_mib, between(0, kMaxCount),
      "memory for scans, MiB; those that do not fit lie in a file in TMPDIR, mapped; 0: half of the memory "
      "of the machine");
}

template <class C, class Visitor>
void visit_sensor(C& c, Visitor&& f) {
    f("sensor.grid", c.sensor.grid, one_of({"native", "kitti360"}),
      "image that is rendered and scored: the sensor's own, or the KITTI-360 grid (66 x 1030)");
    f("sensor.grid_method", c.sensor.grid_method, one_of({"project", "cast"}),
      expert(
          "grid images: simulate the native scan and bin its points, or cast rays through the cell centres"));
    f("sensor.rolling_shutter", c.sensor.rolling_shutter, one_of({"auto", "true", "false"}),
      "rays of a rendered scan start where the sensor is when each is fired; auto: those of the log's own "
      "sensor only if the log's scans "
      "are not motion-compensated");
    f("sensor.calibrate", c.sensor.calibrate, one_of({"none", "range", "intensity", "range,intensity"}),
      "what is found of each beam from the training scans: the offset of its ranges, which differ by "
      "centimetres between beams; gain and "
      "offset of its intensities");
    f("sensor.sub_rays", c.sensor.sub_rays, between(1, 9),
      "rays cast for each one that is simulated, over the footprint of its beam: 1, 5 or 9; what they meet "
      "is put together as a receiver "
      "does");
    f("sensor.divergence_mrad", c.sensor.divergence_mrad, between(0, 100),
      "full beam divergence of the simulated sensor, milliradians; 0: the sensor's own");
    f("sensor.returns", c.sensor.returns, between(1, 2),
      "returns simulated for each ray: 1, or with sensor.sub_rays the strongest and the last (where that is "
      "the strongest, the next "
      "strongest)");
    f("sensor.return_separation_m", c.sensor.return_separation_m, above(0),
      expert("surfaces nearer to each other than this are one return, metres"));
}

template <class C, class Visitor>
void visit_scene(C& c, Visitor&& f) {
    f("init.voxel_m", c.init.voxel_m, above(0),
      "points of all training frames are averaged per voxel of this edge, metres");
    f("init.voxel_growth", c.init.voxel_growth, at_least(0),
      expert("the voxel edge grows by this share of the range to the nearest sensor position; 0: paper"));
    f("init.normals", c.init.normals, anything(),
      expert("orient surfels along normals of the nearest neighbours; false: at random"));
    f("init.unlabelled_movers", c.init.unlabelled_movers, one_of({"background", "removed", "actors"}),
      "what moves without a label belongs to the background (paper), is left out where other training frames "
      "see through it, or that and "
      "becomes an actor with a track of its own");
    f("init.scale_factor", c.init.scale_factor, above(0),
      expert("standard deviation of a new surfel over the mean distance to its 3 nearest neighbours"));
    f("init.max_gap_m", c.init.max_gap_m, at_least(0),
      expert("new surfels on surfaces reach across gaps between scan lines of up to so many metres; 0: all "
             "are round (paper)"));
    f("init.actor_classes", c.init.actor_classes, anything(),
      "moving boxes that become actors of their own, separated by commas: vehicle, cyclist, person, other, "
      "or a dataset's own class; all: "
      "every class; empty: none (init.mask_others says what becomes of them)");
    f("init.mask_others", c.init.mask_others, anything(),
      expert("moving boxes of classes that init.actor_classes leaves out are masked out of points and "
             "losses; false: they belong to the "
             "background (paper)"));
    f("init.actor_tracks", c.init.actor_tracks, anything(),
      expert("tracks that become actors, whatever their class and motion, separated by commas; empty: by "
             "class"));
    f("init.deform", c.init.deform, anything(),
      "actors that bend as they walk, where their points show a gait: vehicle, cyclist, person, other, or a "
      "dataset's own class, separated "
      "by commas; empty: all are rigid (paper)");
    f("init.actor_pad_to", c.init.actor_pad_to, between(0, 1e6),
      expert("an actor with fewer points is filled up with random points of its box; 0: not; paper: 8000"));
    f("init.actor_min_points", c.init.actor_min_points, between(10, 1e6),
      expert("a box with fewer points is masked instead"));
    f("image.alpha_min", c.image.alpha_min, between(1e-6, 0.5),
      expert("a surfel ends where its alpha falls below this (paper: 1/255); the higher, the fewer surfels a "
             "ray meets"));
    f("image.transmittance_min", c.image.transmittance_min, between(0, 0.5),
      expert("a surfel that would bring the transmittance below this ends the ray unseen; less than 0.01, or "
             "opaque surfels do"));
    f("image.sh_degree", c.image.sh_degree, between(0, 3), "degree of the spherical harmonics");
    f("image.sh_direction", c.image.sh_direction, one_of({"ray", "surfel"}),
      expert(
          "spherical harmonics are evaluated per hit along the ray, or once a surfel along sensor to mean"));
    f("image.single_drop_logit", c.image.single_drop_logit, anything(),
      expert("ray-drop is the sigmoid of one blended logit, hit logits stay 0; false: the softmax of two "
             "(paper)"));
    f("image.primitive", c.image.primitive, one_of(primitive_names()),
      expert("what the scene is made of: 2D Gaussians (paper), or 3D Gaussians, in ray query over triangles "
             "with icosahedra as proxies"));
}

template <class C, class Visitor>
void visit_losses(C& c, Visitor&& f) {
#define RELIDAR_TERM(index, name, setting, maker, standard, accepts, meaning) \
    f("loss." #setting, c.loss.setting, accepts, meaning);
    RELIDAR_LOSS_TERMS(RELIDAR_TERM)
#undef RELIDAR_TERM
    f("loss.normalised_depth", c.loss.normalised_depth, anything(),
      expert("the range term compares D / W; false: D, as the paper does"));
}

template <class C, class Visitor>
void visit_training(C& c, Visitor&& f) {
    f("train.iterations", c.train.iterations, between(0, kMaxCount),
      "optimiser steps; 0: keep the initial scene");
    f("train.grid", c.train.grid, one_of({"native", "kitti360"}),
      expert("frames: rays as fired, or images of 66 x 1030 cells (published)"));
    f("train.rays_per_iteration", c.train.rays_per_iteration, between(0, kMaxCount),
      "rays of one step; 0: all rays of one frame");
    f("train.sh_degree_interval", c.train.sh_degree_interval, between(1, kMaxCount),
      expert("the active degree of the spherical harmonics rises by one after so many steps"));
    f("train.only_touched", c.train.only_touched, anything(),
      expert("surfels without a gradient in a step keep their values and moments"));
    f("train.deterministic", c.train.deterministic, anything(),
      "gradients are summed in a fixed order: bit-equal parameters from run to run on one device");
    f("train.sensor_drop", c.train.sensor_drop, anything(),
      expert("learn what the sensor itself never sees (its own vehicle) by itself"));
    f("train.refine_poses", c.train.refine_poses, one_of({"none", "sensor", "actors", "sensor,actors"}),
      "poses that are corrected together with the scene: of the sensor, of the actors' boxes");
    f("train.allow_lost_scans", c.train.allow_lost_scans, anything(),
      "train also where more than 5 % of the scans did not find their place; false: an error");
}

/// Calls f for each setting of logging and checkpoints during training.
template <class C, class Visitor>
void visit_keeping(C& c, Visitor&& f) {
    f("train.frame_memory_mib", c.train.frame_memory_mib, between(0, kMaxCount),
      expert("device memory for rays and targets that stay there, MiB; those of further frames are sent "
             "again whenever it is their turn"));
    f("train.log_every", c.train.log_every, between(1, kMaxCount), "steps between two lines of the log");
    f("train.checkpoint_minutes", c.train.checkpoint_minutes, at_least(0),
      "minutes between two checkpoints; 0: no checkpoint but the one that Ctrl-C leaves");
    f("train.seed", c.train.seed, between(0, kMaxSeed),
      "seed of the initialisation, and of the order of frames and rays");
}

template <class C, class Visitor>
void visit_refine(C& c, Visitor&& f) {
    f("refine.enabled", c.refine.enabled, anything(),
      "training ends with a network that corrects ray-drop (paper, Eq. 12-13), and rendering uses it where a "
      "run has one");
    f("refine.network", c.refine.network, one_of({"small", "paper", "pixel"}),
      "U-Net of 8 channels and 3 levels, the paper's of 32 and 4 with attention, or a function of each pixel "
      "by itself");
    f("refine.image", c.refine.image, one_of({"native", "grid"}),
      expert("what the network looks at: the sensor's rays, before they are binned, or the cells of "
             "sensor.grid"));
    f("refine.rays", c.refine.rays, one_of({"none", "direction", "origin,direction"}),
      expert("inputs of the network about the rays: elevation of the direction, origin of the sensor; the "
             "paper: both"));
    f("refine.frames", c.refine.frames, at_least(0),
      expert("training frames that the network learns from at most, spread over all; 0: all"));
    f("refine.epochs", c.refine.epochs, between(1, 100000), "times that the network sees each of them");
    f("refine.rate", c.refine.rate, above(0),
      expert("the network's learning rate at the start; it falls to a hundredth"));
}

/// Calls f(key, field, accepts, help) for every setting, in the order of the TOML file.
template <class C, class Visitor>
void visit(C& c, Visitor&& f) {
    f("preset", c.preset, one_of({"paper", "released", "default", "quick"}),
      "where all values start from; setting it replaces every other value");
    visit_dataset(c, f);
    visit_sensor(c, f);
    visit_scene(c, f);
    visit_losses(c, f);
    visit_training(c, f);
    visit_keeping(c, f);
    f("blocks.length_m", c.blocks.length_m, between(0, 1e6),
      "the log is trained in blocks of at most so many metres of its trajectory; 0: in one piece");
    f("densify.strategy", c.densify.strategy, one_of({"none", "adaptive"}),
      "surfels are added and removed by their gradients (adaptive, paper)");
    visit_refine(c, f);
    f("render.range", c.render.range, one_of({"expected", "normalised", "median", "mode"}),
      expert("range of a ray in range images: D (paper), D / W, where the transmittance crosses 0.5, or the "
             "mean of the heaviest "
             "surface (hits nearer to each other than sensor.return_separation_m are one)"));
    f("render.channels", c.render.channels, some_of(optional_channel_names()),
      "what scans say of each ray beside the basic channels, in all their outputs; `relidar render --help` "
      "says what they are");
    f("render.points", c.render.points, one_of({"median", "range"}),
      expert("points of point clouds lie where the transmittance crosses 0.5, on the dominant surface, or at "
             "render.range, which has "
             "points between two surfaces"));
    f("render.memory_mib", c.render.memory_mib, between(0, kMaxCount),
      "device memory, MiB, for blocks of a long scene that are kept beside those that a scan needs");
    f("trace.chunk", c.trace.chunk, between(1, 64), expert("hits sorted at a time"));
    f("trace.keep_hits", c.trace.keep_hits, between(0, 4096),
      expert("training: hits kept a ray, 16 bytes each, which need no second search; doubled up to 256 while "
             "any ray has more; "
             "0: cast all again, as the paper does"));
}

}  // namespace relidar::config_detail
