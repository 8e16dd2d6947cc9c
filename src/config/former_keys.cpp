// SPDX-License-Identifier: Apache-2.0
#include "config/former_keys.hpp"

#include <algorithm>
#include <iterator>
#include <optional>

#include <fmt/format.h>

#include <relidar/error.hpp>

#include "core/files.hpp"
#include "core/number_text.hpp"

namespace relidar::config_detail {
namespace {

bool as_bool(const std::string& value) {
    if (value != "true" && value != "false") throw UsageError(fmt::format("found \"{}\", expected true or false", excerpt(value)));
    return value == "true";
}

double as_number(const std::string& value) {
    const std::optional<double> number = parse_number(value);
    if (!number) throw UsageError(fmt::format("found \"{}\", expected a number", excerpt(value)));
    return *number;
}

/// Puts a word that is wanted at the end of a list.
void put(std::string& list, const char* word, bool is_wanted) {
    if (is_wanted) list += (list.empty() ? "" : ",") + std::string(word);
}

void calibrate(Config& config, const char* what, bool is_wanted) {
    const auto wants = [&](const char* word) { return word == std::string(what) ? is_wanted : config.sensor.calibrates(word); };
    std::string list;
    put(list, "range", wants("range"));
    put(list, "intensity", wants("intensity"));
    config.sensor.calibrate = list.empty() ? "none" : list;
}

/// Files name the discovery first: what is found becomes an actor only where it is removed from the background.
void discover(Config& config, bool is_wanted) {
    config.init.unlabelled_movers = is_wanted ? UnlabelledMovers::actors : UnlabelledMovers::removed;
}

void remove_movers(Config& config, bool is_wanted) {
    UnlabelledMovers& movers = config.init.unlabelled_movers;
    if (is_wanted && movers == UnlabelledMovers::background) movers = UnlabelledMovers::removed;
    if (is_wanted) return;
    if (movers == UnlabelledMovers::actors)
        throw UsageError("found false beside init.discover_actors = true, expected true: what becomes an actor leaves the background");
    movers = UnlabelledMovers::background;
}

// In the order in which TOML tables are read, which is that of the alphabet.
const MovedKey kMoved[] = {
    {"init.discover_actors", "init.unlabelled_movers", [](Config& c, const std::string& v) { discover(c, as_bool(v)); }},
    {"init.further_returns", "init.second_returns", [](Config& c, const std::string& v) { c.init.second_returns = as_bool(v); }},
    {"init.hit_logit", "init.hit_margin", [](Config& c, const std::string& v) { c.init.hit_margin = 2.0 * as_number(v) - 1.0; }},
    {"init.remove_unlabelled_movers", "init.unlabelled_movers", [](Config& c, const std::string& v) { remove_movers(c, as_bool(v)); }},
    {"render.normals", "render.channels", [](Config& c, const std::string& v) { put(c.render.channels, "normal", as_bool(v)); }},
    {"render.seen", "render.channels", [](Config& c, const std::string& v) { put(c.render.channels, "seen", as_bool(v)); }},
    {"render.spread", "render.channels", [](Config& c, const std::string& v) { put(c.render.channels, "spread", as_bool(v)); }},
    {"sensor.calibrate_intensity", "sensor.calibrate", [](Config& c, const std::string& v) { calibrate(c, "intensity", as_bool(v)); }},
    {"sensor.calibrate_range", "sensor.calibrate", [](Config& c, const std::string& v) { calibrate(c, "range", as_bool(v)); }},
};

const AddedKey kAdded[] = {
    {"image.alpha_min", "0.003921569"},
};

/// Always the same value, and one that follows from the settings `c`.
#define RELIDAR_ALWAYS(text) [](const Config&, const std::string&) -> std::string { return text; }
#define RELIDAR_FOLLOWS(text) [](const Config& c, const std::string&) -> std::string { return text; }

std::string true_or_false(bool value) { return value ? "true" : "false"; }
std::string batch_now(const Config& c, const std::string& found) {
    if (c.train.rays_per_iteration == 0) return found;   // whole frames, whichever it was
    return c.needs_images() ? "columns" : "rays";
}
bool is_paper(const Config& c) { return c.refine.network == "paper"; }

constexpr const char* kGainedNothing = "it gained nothing beyond noise (docs/results.md)";
constexpr const char* kConstant = "nobody had to turn it, so it is a constant of the code";
constexpr const char* kDevice = "the device decides";

const RemovedKey kRemoved[] = {
    {"dataset.allow_missing_scans", RELIDAR_ALWAYS("true"), "frames without a scan are left out, with a note"},
    {"densify.clone_extent_share", RELIDAR_ALWAYS("2e-4"), kConstant},
    {"densify.growth", RELIDAR_ALWAYS("0.05"), kConstant},
    {"densify.large_from", RELIDAR_ALWAYS("3000"), kConstant},
    {"densify.max_extent_share", RELIDAR_ALWAYS("0.01"), kConstant},
    {"densify.max_surfels", RELIDAR_ALWAYS("4000000"), "growth ends where the device's memory does, or at four million surfels"},
    {"densify.min_opacity", RELIDAR_ALWAYS("0.003"), kConstant},
    {"densify.noise", RELIDAR_ALWAYS("0.2"), kConstant},
    {"densify.opacity_reset_every", RELIDAR_ALWAYS("3000"), kConstant},
    {"densify.prune_unseen", RELIDAR_ALWAYS("false"), kGainedNothing},
    {"densify.reset_opacity", RELIDAR_ALWAYS("0.01"), kConstant},
    {"image.alpha_max", RELIDAR_ALWAYS("0.99"), kConstant},
    {"image.near_m", RELIDAR_ALWAYS("0.2"), kConstant},
    {"init.actor_margin_m", RELIDAR_ALWAYS("0.2"), kConstant},
    {"init.actor_min_step_m", RELIDAR_ALWAYS("0.01"), kConstant},
    {"init.actor_points", RELIDAR_ALWAYS("8000"), kConstant},
    {"init.actor_symmetry", RELIDAR_ALWAYS("false"), "actors keep the sides they were seen from; `relidar assets` mirrors them"},
    {"init.actors", RELIDAR_ALWAYS("models"), "init.actor_classes and init.mask_others say which boxes are actors, masked or background"},
    {"init.drop_logit", RELIDAR_FOLLOWS(number_text(0.5 * (1.0 - c.init.hit_margin))), "init.hit_margin says it"},
    {"init.mask_beyond_labels_s", RELIDAR_ALWAYS("0"), kGainedNothing},
    {"init.seed", RELIDAR_FOLLOWS(fmt::format("{}", c.train.seed)), "train.seed is that of the initialisation too"},
    {"init.smooth", RELIDAR_FOLLOWS(true_or_false(c.init.flatness < 1.0)), "init.flatness below 1 does it"},
    {"loss.box_scale_share", RELIDAR_ALWAYS("0.2"), kConstant},
    {"loss.likelihood_floor", RELIDAR_ALWAYS("0.01"), kConstant},
    {"loss.likelihood_scale_m", RELIDAR_ALWAYS("0.05"), kConstant},
    {"loss.likelihood_scale_share", RELIDAR_ALWAYS("0"), kGainedNothing},
    {"loss.log_range", RELIDAR_ALWAYS("0"), kGainedNothing},
    {"loss.opacity_entropy", RELIDAR_ALWAYS("0"), kGainedNothing},
    {"refine.dropout", RELIDAR_FOLLOWS(is_paper(c) ? "0.1" : "0"), "refine.network=paper has it"},
    {"refine.levels", RELIDAR_ALWAYS("-1"), "each refine.network has its own"},
    {"refine.turn", RELIDAR_FOLLOWS(true_or_false(is_paper(c))), "refine.network=paper has it; others lost by it"},
    {"refine.width", RELIDAR_ALWAYS("0"), "each refine.network has its own"},
    {"sensor.second_return_share", RELIDAR_ALWAYS("0.1"), kConstant},
    {"trace.proxy", nullptr, kDevice},
    {"trace.rebuild_every", nullptr, kConstant},
    {"trace.rebuild_growth", nullptr, kConstant},
    {"trace.walk", nullptr, kDevice},
    {"train.batch", batch_now, "steps see windows of columns where a loss compares neighbours, else groups of columns from all around"},
    {"train.box_rate_m", RELIDAR_FOLLOWS(number_text(10.0 * c.train.pose_rate_m)), "it is ten times train.pose_rate_m"},
    {"train.box_rate_rad", RELIDAR_FOLLOWS(number_text(c.train.pose_rate_m)), "it is train.pose_rate_m, in radians"},
    {"train.checkpoint_keep", nullptr, "the newest two are kept"},
    {"train.extent_m", RELIDAR_ALWAYS("0"), "it is measured"},
    {"train.gather_hits", nullptr, kConstant},
    {"train.gradient_sums", RELIDAR_ALWAYS("automatic"), "the device decides, or train.deterministic"},
    {"train.own_extents", RELIDAR_FOLLOWS(true_or_false(c.densify.strategy == DensifyStrategy::adaptive)),
     "densify.strategy=adaptive does it"},
    {"train.pose_from", RELIDAR_ALWAYS("0"), kGainedNothing},
    {"train.pose_largest_m", RELIDAR_ALWAYS("1"), kConstant},
    {"train.pose_prior_per_m2", RELIDAR_ALWAYS("0.01"), kConstant},
    {"train.pose_prior_per_rad2", RELIDAR_ALWAYS("0.1"), kConstant},
    {"train.pose_rate_rad", RELIDAR_FOLLOWS(number_text(c.train.pose_rate_m / 10.0)), "it is a tenth of train.pose_rate_m"},
    {"train.second_returns", RELIDAR_ALWAYS("false"), kGainedNothing},
    {"train.sh_rest_factor", RELIDAR_ALWAYS("0.05"), kConstant},
    {"train.sub_rays", RELIDAR_ALWAYS("1"), kGainedNothing},
};
#undef RELIDAR_ALWAYS
#undef RELIDAR_FOLLOWS

template <class Key, std::size_t n>
const Key* find(const Key (&keys)[n], const std::string& name) {
    const auto found = std::find_if(std::begin(keys), std::end(keys), [&](const Key& key) { return key.key == name; });
    return found == std::end(keys) ? nullptr : found;
}

}  // namespace

std::span<const AddedKey> added_keys() { return kAdded; }

const RemovedKey* find_removed(const std::string& key) { return find(kRemoved, key); }
const MovedKey* find_moved(const std::string& key) { return find(kMoved, key); }

void check_removed(const Config& config, const RemovedKey& removed, const std::string& found) {
    if (!removed.now) return;
    const std::string now = removed.now(config, found);
    const std::optional<double> a = parse_number(found), b = parse_number(now);
    if (a && b ? *a == *b : found == now) return;
    throw UsageError(fmt::format("setting {}: found {}, expected {}: it was removed: {}", removed.key, excerpt(found), now, removed.why));
}

}  // namespace relidar::config_detail
