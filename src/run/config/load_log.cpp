// SPDX-License-Identifier: Apache-2.0
#include <relidar/run/run.hpp>

#include <cmath>

#include <relidar/read/dataset.hpp>

#include "base/list_text.hpp"

namespace relidar {

Log load_log(const Config& config, const Progress& progress, int max_scans) {
    DatasetOptions options;
    options.sequence = config.dataset.sequence;
    options.lidars = split_list(config.dataset.lidars);
    options.frames = {config.dataset.frames_begin, config.dataset.frames_end};
    options.poses_file = config.dataset.poses;
    options.skip_broken = config.dataset.skip_broken;
    options.rolling_shutter = config.sensor.rolling_shutter != RollingShutter::no;
    // The setting 0 means no limit.
    options.max_range_m = config.dataset.max_range_m > 0.0 ? config.dataset.max_range_m : INFINITY;
    options.min_range_m = config.dataset.min_range_m;
    options.bag.poses_from = config.dataset.poses_from;
    options.waymo.clamp_intensity = config.dataset.waymo_intensity == "clamp";
    options.progress = progress;
    options.max_scans = max_scans;
    return load_sequence(config.dataset.path, options);
}

}  // namespace relidar
