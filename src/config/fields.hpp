// SPDX-License-Identifier: Apache-2.0
// The one table of settings: key, value, what it accepts, what it means. Keys, `--set`, TOML in and out and `--help` all walk
// it, so a new setting is a field in <relidar/config.hpp> and a line here; weights of losses come from their own table. Private to config.
#pragma once

#include <limits>
#include <string>
#include <type_traits>
#include <vector>

#include <relidar/channels.hpp>
#include <relidar/config.hpp>

namespace relidar::config_detail {

/// What a field accepts.
struct Accepts {
    double low = std::numeric_limits<double>::lowest();
    double high = std::numeric_limits<double>::max();
    bool above_low = false;              ///< low itself is refused
    std::vector<std::string> choices;    ///< of a text or enum field; an enum's value is its place in this list
    bool several = false;                ///< a text of any of the choices, separated by commas
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

inline constexpr double kMaxCount = 2147483647.0;
inline constexpr double kMaxSeed = 9007199254740992.0;   // 2^53: a TOML integer and a double hold it exactly

template <class C, class Visitor>
void visit_dataset(C& c, Visitor&& f) {
    f("dataset.path", c.dataset.path, anything(), "dataset: a path, or kind:path; training fills it in");
    f("dataset.sequence", c.dataset.sequence, anything(),
      "which drive of a dataset that holds several, by its own name; empty: the only one, or the first");
    f("dataset.lidars", c.dataset.lidars, anything(),
      "names of the LiDARs that are read of a log with several, separated by commas; empty: all");
    f("dataset.frames_begin", c.dataset.frames_begin, between(0, kMaxCount), "first frame, by the dataset's own number");
    f("dataset.frames_end", c.dataset.frames_end, between(-1, kMaxCount), "frame after the last one; -1: to the end of the log");
    f("dataset.test_every", c.dataset.test_every, between(0, kMaxCount), "every so many frames one is held out for testing; 0: none");
    f("dataset.test_frames", c.dataset.test_frames, anything(),
      "frames that are held out for testing, by the dataset's own numbers, ends of ranges not included, as in 13,26,40:45; empty: "
      "dataset.test_every decides");
    f("dataset.poses", c.dataset.poses, anything(),
      "file with 12 numbers a line, world_from_sensor of each frame; empty: the dataset's own poses; none: no poses, they are found from "
      "the scans alone");
    f("dataset.poses_from", c.dataset.poses_from, anything(),
      "of a ROS bag: frame of /tf, such as map or odom, or topic of odometry or poses that says where the LiDAR was; empty: guessed, info "
      "says what is used");
    f("dataset.allow_missing_scans", c.dataset.allow_missing_scans, anything(),
      "leave frames without a scan out, with a note; false: a missing scan is an error");
    f("dataset.skip_broken", c.dataset.skip_broken, anything(),
      "leave scans that cannot be read out, with a note each; false: the first of them is an error");
    f("dataset.min_range_m", c.dataset.min_range_m, at_least(0),
      "returns nearer than this count as dropped, and the log's sensor simulates none there, metres");
    f("dataset.max_range_m", c.dataset.max_range_m, above(0),
      "returns beyond this range count as dropped, and the log's sensor simulates none there, metres");
    f("dataset.waymo_intensity", c.dataset.waymo_intensity, one_of({"tanh", "clamp"}),
      "intensities of Waymo Open, which have no upper end: their tanh, or cut at 1");
    f("dataset.memory_mib", c.dataset.memory_mib, between(0, kMaxCount),
      "memory for scans, MiB; those that do not fit lie in a file in TMPDIR, mapped; 0: half of the memory of the machine");
}

template <class C, class Visitor>
void visit_sensor(C& c, Visitor&& f) {
    f("sensor.grid", c.sensor.grid, one_of({"native", "kitti360"}),
      "image that is rendered and scored: the sensor's own, or the KITTI-360 grid (66 x 1030)");
    f("sensor.grid_method", c.sensor.grid_method, one_of({"project", "cast"}),
      "grid images: simulate the native scan and bin its points, or cast rays through the cell centres");
    f("sensor.rolling_shutter", c.sensor.rolling_shutter, anything(), "rays start where the sensor was when they were fired");
    f("sensor.calibrate_intensity", c.sensor.calibrate_intensity, anything(),
      "find gain and offset of each beam's intensity from the training scans: surfaces have one brightness, beams differ");
    f("sensor.sub_rays", c.sensor.sub_rays, between(1, 9),
      "rays cast for each one that is simulated, over the footprint of its beam: 1, 5 or 9; what they meet is put together as a receiver "
      "does");
    f("sensor.divergence_mrad", c.sensor.divergence_mrad, between(0, 100),
      "full beam divergence of the simulated sensor, milliradians; 0: the sensor's own");
    f("sensor.returns", c.sensor.returns, between(1, 2),
      "returns simulated for each ray: 1, or with sensor.sub_rays the strongest and the last (where that is the strongest, the next "
      "strongest)");
    f("sensor.return_separation_m", c.sensor.return_separation_m, above(0),
      "surfaces nearer to each other than this are one return, metres");
    f("sensor.second_return_share", c.sensor.second_return_share, Accepts{0.0, 1.0, true, {}},
      "light that a second return needs, over the strongest's");
    f("sensor.calibrate_range", c.sensor.calibrate_range, anything(),
      "find what each beam adds to its ranges from the training scans: centimetres, that differ between beams");
}

template <class C, class Visitor>
void visit_scene(C& c, Visitor&& f) {
    f("init.voxel_m", c.init.voxel_m, above(0), "points of all training frames are averaged per voxel of this edge, metres");
    f("init.voxel_growth", c.init.voxel_growth, at_least(0),
      "the voxel edge grows by this share of the range to the nearest sensor position; 0: paper");
    f("init.normals", c.init.normals, anything(), "orient surfels along normals of the nearest neighbours; false: at random");
    f("init.normal_neighbours", c.init.normal_neighbours, between(3, 1000), "neighbours a normal is fitted to");
    f("init.flatness", c.init.flatness, between(0, 1),
      "where points scatter across their plane by more than this share of the variance in it, surfels face the sensor; 1: paper");
    f("init.smooth", c.init.smooth, anything(), "move each new surfel onto the plane of its neighbours");
    f("init.further_returns", c.init.further_returns, anything(), "second returns are points of the start too, where the log has them");
    f("init.remove_unlabelled_movers", c.init.remove_unlabelled_movers, anything(),
      "leave out points that other training frames see through");
    f("init.opacity", c.init.opacity, Accepts{0.0, 0.99, true, {}}, "opacity of new surfels");
    f("init.hit_logit", c.init.hit_logit, between(-20, 20), "hit logit of new surfels");
    f("init.drop_logit", c.init.drop_logit, between(-20, 20), "drop logit of new surfels");
    f("init.max_scale_m", c.init.max_scale_m, above(0),
      "largest standard deviation of a new surfel, but across gaps between scan lines, metres");
    f("init.scale_factor", c.init.scale_factor, above(0),
      "standard deviation of a new surfel over the mean distance to its 3 nearest neighbours");
    f("init.max_gap_m", c.init.max_gap_m, at_least(0),
      "new surfels on surfaces reach across gaps between scan lines of up to so many metres; 0: all are round (paper)");
    f("init.thickness", c.init.thickness, between(1e-3, 10),
      "image.primitive=gaussian: standard deviation of a new Gaussian along its normal over that in the plane; 1: spheres");
    f("init.discover_actors", c.init.discover_actors, anything(),
      "what moves without a label becomes an actor with a track of its own, found from returns that other frames see through");
    f("init.actor_min_step_m", c.init.actor_min_step_m, at_least(0),
      "boxes that move more than this a frame are actors: their points are left out, metres");
    f("init.actor_margin_m", c.init.actor_margin_m, at_least(0), "boxes are grown by this when points are left out, metres");
    f("init.actors", c.init.actors, one_of({"models", "masked", "background"}),
      "moving boxes become models of their own, are masked out, or belong to the background (see init.remove_unlabelled_movers)");
    f("init.actor_classes", c.init.actor_classes, anything(),
      "moving boxes that become actors of their own, separated by commas: vehicle, cyclist, person, other, or a dataset's own class; all: "
      "every class; empty: none (init.mask_others says what becomes of them)");
    f("init.mask_others", c.init.mask_others, anything(),
      "moving boxes of classes that init.actor_classes leaves out are masked out of points and losses; false: they belong to the "
      "background (paper)");
    f("init.actor_points", c.init.actor_points, between(1, 1e6), "most surfels of an actor");
    f("init.actor_tracks", c.init.actor_tracks, anything(),
      "tracks that become actors, whatever their class and motion, separated by commas; empty: by class");
    f("init.actor_pad_to", c.init.actor_pad_to, between(0, 1e6),
      "an actor with fewer points is filled up with random points of its box; 0: not; paper: 8000");
    f("init.actor_symmetry", c.init.actor_symmetry, anything(), "mirror the points of an actor left to right");
    f("init.mask_beyond_labels_s", c.init.mask_beyond_labels_s, between(0, 1e3),
      "boxes are masked so long before their first and after their last label, where they would be, seconds");
    f("init.actor_min_points", c.init.actor_min_points, between(10, 1e6), "a box with fewer points is masked instead");
    f("init.seed", c.init.seed, between(0, kMaxSeed), "seed of the initialisation");
    f("image.near_m", c.image.near_m, at_least(0), "hits nearer than this are ignored, metres");
    f("image.alpha_min", c.image.alpha_min, between(1e-6, 0.5), "a surfel that contributes less alpha is skipped");
    f("image.alpha_max", c.image.alpha_max, between(0.5, 0.9999), "alpha is clamped to this");
    f("image.transmittance_min", c.image.transmittance_min, between(0, 0.5),
      "a surfel that would bring the transmittance below this ends the ray unseen; less than 1 - image.alpha_max, or opaque surfels do");
    f("image.sh_degree", c.image.sh_degree, between(0, 3), "degree of the spherical harmonics");
    f("image.sh_direction", c.image.sh_direction, one_of({"ray", "surfel"}),
      "spherical harmonics are evaluated per hit along the ray, or once a surfel along sensor to mean");
    f("image.single_drop_logit", c.image.single_drop_logit, anything(),
      "ray-drop is the sigmoid of one blended logit, hit logits stay 0; false: the softmax of two (paper)");
    f("image.primitive", c.image.primitive, one_of(primitive_names()),
      "what the scene is made of: 2D Gaussians (paper), or 3D Gaussians, in ray query over triangles with icosahedra as proxies");
}

template <class C, class Visitor>
void visit_losses(C& c, Visitor&& f) {
#define RELIDAR_TERM(index, name, setting, standard, accepts, meaning) f("loss." #setting, c.loss.setting, accepts, meaning);
    RELIDAR_LOSS_TERMS(RELIDAR_TERM)
#undef RELIDAR_TERM
    f("loss.normalised_depth", c.loss.normalised_depth, anything(), "the range term compares D / W; false: D, as the paper does");
    f("loss.box_scale_share", c.loss.box_scale_share, above(0),
      "standard deviation an actor's surfel may have, over half the diagonal of its box");
    f("loss.likelihood_scale_m", c.loss.likelihood_scale_m, between(1e-3, 100),
      "loss.likelihood: how far measured ranges lie from what is there, metres: a hit so far off counts half");
    f("loss.likelihood_scale_share", c.loss.likelihood_scale_share, between(0, 1),
      "loss.likelihood: what is added to loss.likelihood_scale_m, times the measured range");
    f("loss.likelihood_floor", c.loss.likelihood_floor, between(1e-6, 0.5),
      "loss.likelihood: share of returns that may lie anywhere, so that one that nothing explains does not pull without bound");
}

template <class C, class Visitor>
void visit_training(C& c, Visitor&& f) {
    f("train.iterations", c.train.iterations, between(0, kMaxCount), "optimiser steps; 0: keep the initial scene");
    f("train.grid", c.train.grid, one_of({"native", "kitti360"}), "frames: rays as fired, or images of 66 x 1030 cells (published)");
    f("train.rays_per_iteration", c.train.rays_per_iteration, between(0, kMaxCount), "rays of one step; 0: all rays of one frame");
    f("train.batch", c.train.batch, one_of({"rays", "columns"}),
      "rays of one step are every n-th column of the frame (every n-th ray without image order), or a window of neighbouring columns");
    f("train.sh_degree_start", c.train.sh_degree_start, between(0, 3), "degree of the spherical harmonics that is active from the start");
    f("train.sh_degree_interval", c.train.sh_degree_interval, between(1, kMaxCount),
      "the active degree of the spherical harmonics rises by one after so many steps");
    f("train.own_extents", c.train.own_extents, anything(), "means of actors learn at the extent of their own box, not the background's");
    f("train.mean_rate", c.train.mean_rate, at_least(0), "learning rate of the means at the start, times the extent");
    f("train.mean_rate_final", c.train.mean_rate_final, at_least(0), "learning rate of the means at the end, times the extent");
    f("train.rotation_rate", c.train.rotation_rate, at_least(0), "learning rate of the rotations");
    f("train.scale_rate", c.train.scale_rate, at_least(0), "learning rate of the log scales");
    f("train.max_growth", c.train.max_growth, at_least(1), "surfels grow to so many times their first standard deviation at most");
    f("train.opacity_rate", c.train.opacity_rate, at_least(0), "learning rate of the opacity logits");
    f("train.sh_rate", c.train.sh_rate, at_least(0), "learning rate of the constant coefficient of each channel");
    f("train.sh_rest_factor", c.train.sh_rest_factor, at_least(0), "rate of the other coefficients over train.sh_rate");
    f("train.intensity_factor", c.train.intensity_factor, at_least(0), "rates of the intensity's harmonics over those of the drop logits");
    f("train.rate_decay", c.train.rate_decay, Accepts{0.0, 1.0, true, {}}, "every rate but the mean's ends at this share of its start");
    f("train.extent_m", c.train.extent_m, at_least(0), "extent of the scene, metres; 0: measured");
    f("train.only_touched", c.train.only_touched, anything(), "surfels without a gradient in a step keep their values and moments");
    f("train.deterministic", c.train.deterministic, anything(),
      "gradients are summed in a fixed order: bit-equal parameters from run to run on one device");
    f("train.gradient_sums", c.train.gradient_sums, one_of({"automatic", "atomics", "gather"}),
      "gradients of a surfel's hits are added by float atomics, or gathered from records of all hits; automatic: gathered where harmonics "
      "are evaluated per hit and on devices without float atomics");
    f("train.gather_hits", c.train.gather_hits, between(1, 4096),
      "room for so many hit records a ray where gradients are summed in a fixed order");
    f("train.sub_rays", c.train.sub_rays, between(1, 9), "rays cast for a beam of a step, over its footprint: 1, 5 or 9");
    f("train.second_returns", c.train.second_returns, anything(),
      "second returns that lie farther are rays of their own, which start behind the first surface; scans with any lose their image order");
    f("train.sensor_drop", c.train.sensor_drop, anything(), "learn what the sensor itself never sees (its own vehicle) by itself");
    f("train.refine_poses", c.train.refine_poses, one_of({"none", "sensor", "actors", "sensor,actors"}),
      "poses that are corrected together with the scene: of the sensor, of the actors' boxes");
    f("train.pose_register", c.train.pose_register, anything(),
      "where the sensor's poses are refined, they start from a registration of the scans, before the scene is initialised");
    f("train.place_held_out", c.train.place_held_out, anything(),
      "where scans were registered, held-out ones are placed once more by their own returns, on the trained scene, which stays");
    f("train.pose_largest_m", c.train.pose_largest_m, between(0.05, 100.0),
      "how far, in metres, a scan's correction may be from its neighbours', and the same surface from itself once the scans were followed; "
      "a scan beyond is moved as its neighbours are");
    f("train.allow_lost_scans", c.train.allow_lost_scans, anything(),
      "train also where more than 5 % of the scans did not find their place; false: an error");
    f("train.pose_from", c.train.pose_from, between(0, kMaxCount), "poses stay as they are up to this step");
    f("train.pose_rate_m", c.train.pose_rate_m, at_least(0),
      "learning rate of the sensor's translations at the start, metres; a tenth at the end; without train.pose_register 2e-3 and more "
      "follow centimetres");
    f("train.pose_rate_rad", c.train.pose_rate_rad, at_least(0),
      "learning rate of the sensor's rotations at the start, radians; a tenth at the end");
    f("train.box_rate_m", c.train.box_rate_m, at_least(0),
      "learning rate of the boxes' translations at the start, metres; a tenth at the end");
    f("train.box_rate_rad", c.train.box_rate_rad, at_least(0),
      "learning rate of the boxes' rotations at the start, radians; a tenth at the end");
    f("train.pose_prior_per_m2", c.train.pose_prior_per_m2, at_least(0),
      "weight of the squared translation of a correction, per square metre");
    f("train.pose_prior_per_rad2", c.train.pose_prior_per_rad2, at_least(0),
      "weight of the squared rotation of a correction, per square radian");
}

/// What training tells and keeps.
template <class C, class Visitor>
void visit_keeping(C& c, Visitor&& f) {
    f("train.frame_memory_mib", c.train.frame_memory_mib, between(0, kMaxCount),
      "device memory for rays and targets that stay there, MiB; those of further frames are sent again whenever it is their turn");
    f("train.log_every", c.train.log_every, between(1, kMaxCount), "steps between two lines of the log");
    f("train.checkpoint_every", c.train.checkpoint_every, between(0, kMaxCount), "steps between two checkpoints; 0: by time alone");
    f("train.checkpoint_minutes", c.train.checkpoint_minutes, at_least(0),
      "minutes between two checkpoints; 0: by steps alone; Ctrl-C always leaves one");
    f("train.checkpoint_keep", c.train.checkpoint_keep, between(1, kMaxCount), "the newest so many checkpoints are kept");
    f("train.seed", c.train.seed, between(0, kMaxSeed), "seed of the order of frames and rays");
}

template <class C, class Visitor>
void visit_blocks(C& c, Visitor&& f) {
    f("blocks.length_m", c.blocks.length_m, between(0, 1e6),
      "the log is trained in blocks of at most so many metres of its way; 0: in one piece");
    f("blocks.halo_m", c.blocks.halo_m, between(0, 1e6), "training frames that were taken so near to a block are trained on with it");
    f("blocks.actor_epochs", c.blocks.actor_epochs, between(0, 1000),
      "so often every training frame teaches the actors once the blocks are joined; 0: actors stay as a block has left them");
}

template <class C, class Visitor>
void visit_densify(C& c, Visitor&& f) {
    f("densify.strategy", c.densify.strategy, one_of({"none", "adaptive", "prune_only", "mcmc"}),
      "surfels are added and removed: by gradient (adaptive, paper), removed only, or moved from dead to living and grown (mcmc)");
    f("densify.from", c.densify.from, between(0, kMaxCount), "first step after which surfels are added and removed");
    f("densify.until", c.densify.until, between(0, kMaxCount), "from this step on no surfel is added, removed or reset");
    f("densify.every", c.densify.every, between(1, kMaxCount), "steps between");
    f("densify.gradient_threshold", c.densify.gradient_threshold, at_least(0),
      "adaptive: a surfel grows above this mean norm of the gradient of its mean, the loss being a mean over a frame");
    f("densify.clone_extent_share", c.densify.clone_extent_share, at_least(0),
      "adaptive: below this share of the extent a growing surfel is cloned, above it is split");
    f("densify.min_opacity", c.densify.min_opacity, between(0, 0.5), "fainter surfels are removed; at least image.alpha_min counts");
    f("densify.max_extent_share", c.densify.max_extent_share, above(0),
      "adaptive, prune_only: surfels larger than this share of the extent are removed");
    f("densify.large_from", c.densify.large_from, between(0, kMaxCount), "step after which large surfels are removed");
    f("densify.opacity_reset_every", c.densify.opacity_reset_every, between(0, kMaxCount),
      "adaptive: steps between two resets of all opacities; 0: never");
    f("densify.reset_opacity", c.densify.reset_opacity, Accepts{0.0, 0.99, true, {}}, "adaptive: opacities are reset to at most this");
    f("densify.max_surfels", c.densify.max_surfels, between(1, 16000000), "no growth beyond this many surfels");
    f("densify.growth", c.densify.growth, between(0, 1), "mcmc: share of surfels added each time");
    f("densify.noise", c.densify.noise, at_least(0),
      "mcmc: noise on the means of faint surfels at the first learning rate, in standard deviations of the surfel");
    f("densify.prune_unseen", c.densify.prune_unseen, anything(),
      "at the end of training remove surfels that no training frame gives a gradient");
}

template <class C, class Visitor>
void visit_refine(C& c, Visitor&& f) {
    f("refine.enabled", c.refine.enabled, anything(),
      "training ends with a network that corrects ray-drop (paper, Eq. 12-13), and rendering uses it where a run has one");
    f("refine.network", c.refine.network, one_of({"small", "paper", "pixel"}),
      "U-Net of 8 channels and 3 levels, the paper's of 32 and 4 with attention, or a function of each pixel by itself");
    f("refine.width", c.refine.width, between(0, 512), "channels of the network at full size; 0: its own");
    f("refine.levels", c.refine.levels, between(-1, 6), "times that the network halves the image; -1: its own");
    f("refine.image", c.refine.image, one_of({"native", "grid"}),
      "what the network looks at: the sensor's rays, before they are binned, or the cells of sensor.grid");
    f("refine.rays", c.refine.rays, one_of({"none", "direction", "origin,direction"}),
      "what the network is told of the rays; the paper: both");
    f("refine.frames", c.refine.frames, at_least(0), "training frames that the network learns from at most, spread over all; 0: all");
    f("refine.epochs", c.refine.epochs, between(1, 100000), "times that the network sees each of them");
    f("refine.batch", c.refine.batch, between(1, 1024), "frames a step of the network's training");
    f("refine.rate", c.refine.rate, above(0), "the network's learning rate at the start; it falls to a hundredth");
    f("refine.dropout", c.refine.dropout, between(0, 0.9), "share of the values that the network's layers drop in training");
    f("refine.turn", c.refine.turn, anything(),
      "what the network sees in training is turned about the sensor by random columns, and the rays it is told stay");
    f("refine.precision", c.refine.precision, one_of({"fp32", "fp16"}),
      "what the network's convolutions multiply in training; fp16: by matrix units, where `relidar devices` shows them; sums are fp32");
    f("refine.storage", c.refine.storage, one_of({"fp32", "fp16"}),
      "what images between the network's layers are kept as in training; fp16: half of the memory, where the device has arrays of halves");
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
    visit_blocks(c, f);
    visit_densify(c, f);
    visit_refine(c, f);
    f("render.range", c.render.range, one_of({"expected", "normalised", "median", "mode"}),
      "range of a ray in range images: D (paper), D / W, where the transmittance crosses 0.5, or the mean of the heaviest surface (hits "
      "nearer to each other than sensor.return_separation_m are one)");
    f("render.follow_sweeps", c.render.follow_sweeps, anything(),
      "the log's own sensor, rendered at one of its sweeps, has the azimuths of that sweep; false: nominal ones, evenly spaced (paper)");
    f("render.channels", c.render.channels, some_of(optional_channel_names()),
      "what scans say of each ray beside the basic channels, in all their outputs; `relidar render --help` says what they are");
    f("render.points", c.render.points, one_of({"median", "range"}),
      "points of point clouds lie where the transmittance crosses 0.5, on the dominant surface, or at render.range, which has points "
      "between two surfaces");
    f("render.memory_mib", c.render.memory_mib, between(0, kMaxCount),
      "device memory, MiB, for blocks of a long scene that are kept beside those that a scan needs");
    f("eval.lpips_weights", c.eval.lpips_weights, anything(),
      "safetensors file with the weights of LPIPS (AlexNet, v0.1); empty: no LPIPS, unless RELIDAR_LPIPS_WEIGHTS names them to the command "
      "line");
    f("trace.chunk", c.trace.chunk, between(1, 64), "hits sorted at a time");
    f("trace.proxy", c.trace.proxy, one_of({"automatic", "triangles", "boxes"}),
      "what stands for a surfel in the driver's acceleration structure (ray query)");
    f("trace.walk", c.trace.walk, one_of({"automatic", "lane", "subgroup"}),
      "rays walk the tree each on its own or by subgroups (software traversal)");
    f("trace.rebuild_every", c.trace.rebuild_every, at_least(0), "refits of the acceleration structure before it is built anew; 0 = never");
    f("trace.rebuild_growth", c.trace.rebuild_growth, between(1.0, 1000.0),
      "cost of the tree over its cost when built that has it built anew; looked at with each log line (software traversal)");
    f("trace.keep_hits", c.trace.keep_hits, between(0, 4096),
      "training: hits kept a ray, 8 bytes each, which need no second search; doubled up to 256 while more than one ray in a hundred has "
      "more; 0: cast all again, as the paper does");
}

}  // namespace relidar::config_detail
