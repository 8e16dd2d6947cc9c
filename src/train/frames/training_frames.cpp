// SPDX-License-Identifier: Apache-2.0
// Keeps the first frames of the log in device memory, because training uses frames in
// random order. All others share one set of arrays: the stream uploads a frame only after
// the iteration of the previous frame.
#include "train/frames/training_frames.hpp"

#include <algorithm>
#include <utility>

#include "base/fail.hpp"
#include "base/parallel.hpp"
#include "gpu/stream.hpp"

namespace relidar {

Frame frame_to_grid(const Log& log, const Frame& frame, const RangeImageGrid& grid) {
    constexpr double kGridPeriod_s = 0.1;  // sweep duration that make_rays() assumes for a grid
    const Scan& scan = frame.scan;
    // The returns of the scan, and the ray of each.
    std::vector<glm::vec3> points;
    std::vector<float> intensity;
    std::vector<std::size_t> ray_of_point;
    for (std::size_t ray = 0; ray < scan.range_m.size(); ++ray) {
        if (!(scan.range_m[ray] > 0.0f)) continue;
        points.push_back(scan.return_point(ray));
        intensity.push_back(scan.intensity[ray]);
        ray_of_point.push_back(ray);
    }
    const ProjectedRangeImage image = project_points(grid, points, intensity);
    Frame result = strip_scan(frame);
    result.scan.rays = make_rays(grid);
    result.scan.range_m.assign(image.range_m.begin(), image.range_m.end());
    result.scan.intensity.assign(image.intensity.begin(), image.intensity.end());
    const auto period_ratio = static_cast<float>(log.lidar_of(frame).sweep_period_s() / kGridPeriod_s);
    for (std::size_t cell = 0; cell < image.source.size(); ++cell) {
        float& time_s = result.scan.rays.time_offset_s[cell];
        time_s *= period_ratio;                // remains the time of a cell without a return
        const int point = image.source[cell];  // the nearest return, or -1
        if (point < 0) continue;
        const std::size_t ray = ray_of_point[std::size_t(point)];
        time_s = scan.rays.time_offset_s[ray];
        result.scan.rays.channel[cell] = scan.rays.channel[ray];
    }
    return result;
}

namespace {

constexpr std::size_t kPreparedAtOnce = 32;  // frames prepared in parallel in host memory

/// Returns the absolute time at which a ray was fired. Without rolling shutter, all rays
/// of a frame have the time of the frame.
double firing_time_s(const Log& log, const Frame& frame, float offset_s) {
    return frame.time_s + (log.rolling_shutter ? double(offset_s) : 0.0);
}

/// Frame with the trained rays: a copy with the rays of a grid, or the frame of the log.
struct TrainedFrame {
    std::optional<Frame> gridded;
    const Frame& frame;

    TrainedFrame(const Log& log, int position, const std::optional<RangeImageGrid>& grid)
        : gridded(grid ? std::optional(frame_to_grid(log, log.frames[std::size_t(position)], *grid))
                       : std::nullopt),
          frame(gridded ? *gridded : log.frames[std::size_t(position)]) {}
};

/// Sets the range of vehicle poses (knots) between which the rays of a frame were fired:
/// from the pose before the first ray to the pose after the last ray.
void set_knots(TrainingFrameData& data, const Log& log, const Frame& frame) {
    const PoseTrack& track = log.world_from_vehicle;
    const ScanArray<float>& offsets_s = frame.scan.rays.time_offset_s;
    const auto [first, last] = std::minmax_element(offsets_s.begin(), offsets_s.end());
    data.first_knot = track.find_segment(firing_time_s(log, frame, *first)).left;
    const std::size_t knot_before_last = track.find_segment(firing_time_s(log, frame, *last)).left;
    const std::size_t last_knot = std::min(knot_before_last + 1, track.pose.size() - 1);
    data.n_knots = static_cast<std::uint32_t>(last_knot + 1 - data.first_knot);
}

/// Returns the shape, the sensor position and the range of vehicle poses of a frame. Its
/// device arrays are not allocated yet.
/// @throws DataError if the frame has no ray
TrainingFrameData describe_frame(const Log& log, int index, const std::optional<RangeImageGrid>& grid) {
    const TrainedFrame trained(log, index, grid);
    const Frame& frame = trained.frame;
    const RayTable& table = frame.scan.rays;
    if (frame.scan.range_m.empty())
        fail("cannot use frame {} of {} for training: its scan has no rays, expected at least one",
             frame.index, log.name);
    TrainingFrameData data;
    data.position = index;
    data.index = frame.index;
    data.n_rays = static_cast<std::uint32_t>(frame.scan.range_m.size());
    if (table.rows > 1)
        data.image = {static_cast<std::uint32_t>(table.rows), static_cast<std::uint32_t>(table.columns),
                      is_full_turn(table.rows, table.columns, table.direction)};
    set_knots(data, log, frame);
    const Pose world_from_sensor =
        log.world_from_vehicle.mounted_pose_at(frame.time_s, log.lidar_of(frame).vehicle_from_sensor);
    data.sensor_position_m = glm::vec3(world_from_sensor.translation);
    return data;
}

/// Counts the rays that training uses, and how many of them have a return.
void count_rays(TrainingFrameData& data, const std::vector<DeviceTarget>& targets) {
    data.n_known_rays = data.n_returned = 0.0;
    for (const DeviceTarget& target : targets) {
        if (!(target.weight > 0.0f)) continue;  // ignored ray
        data.n_known_rays += 1.0;
        if (target.range_m > 0.0f) data.n_returned += 1.0;
    }
}

template <class T>
void upload_values(Stream& stream, const Array<T>& target, const std::vector<T>& values) {
    stream.impl().record_write(target.buffer(), values.data(), values.size() * sizeof(T));
}

}  // namespace

std::size_t TrainingFrames::bytes_per_ray() const {
    return sizeof(DeviceRay) + sizeof(DeviceTarget) +
           (use_.moves_rays ? sizeof(shared::PoseInterpolation) : 0);
}

TrainingFrames::TrainingFrames(Device& device, const Log& log, const std::vector<int>& frame_indices,
                               FrameUploadOptions use)
    : log_(log), use_(std::move(use)) {
    for (const int position : frame_indices) frames_.push_back(describe_frame(log, position, use_.grid));
    std::uint64_t bytes = 0;  // device memory of the frames so far
    for (const TrainingFrameData& frame : frames_) {
        bytes += std::uint64_t(frame.n_rays) * bytes_per_ray();
        if (bytes > use_.resident_bytes) break;
        ++n_staying_;
    }
    upload_frames(device);
    // All other frames share arrays that are large enough for each of them.
    const std::uint32_t n_rays = max_frame_rays(std::span(frames_).subspan(n_staying_));
    if (n_rays == 0) return;
    shared_ = std::make_shared<FrameArrays>(
        FrameArrays{.rays = {device, n_rays, "training rays"},
                    .targets = {device, n_rays, "training targets"},
                    .track_positions = {device, use_.moves_rays ? n_rays : 0, "track positions of rays"}});
    for (std::size_t i = n_staying_; i < frames_.size(); ++i) frames_[i].arrays = shared_;
}

/// Uploads the resident frames in groups, whose size limits host memory.
void TrainingFrames::upload_frames(Device& device) {
    for (std::size_t first = 0; first < n_staying_; first += kPreparedAtOnce) {
        std::vector<HostFrameArrays> batch(std::min(kPreparedAtOnce, n_staying_ - first));
        parallel_for(static_cast<int>(batch.size()),
                     [&](int k) { batch[std::size_t(k)] = compute_arrays(first + std::size_t(k)); });
        for (std::size_t k = 0; k < batch.size(); ++k) {
            TrainingFrameData& frame = frames_[first + k];
            frame.arrays = std::make_shared<FrameArrays>(
                FrameArrays{{device, std::span<const DeviceRay>(batch[k].rays), "training rays"},
                            {device, std::span<const DeviceTarget>(batch[k].targets), "training targets"},
                            {device, std::span<const shared::PoseInterpolation>(batch[k].track_positions),
                             "track positions of rays"}});
            count_rays(frame, batch[k].targets);
        }
    }
}

/// Computes the arrays of a frame on the host. If poses are refined, also stores between
/// which vehicle poses each ray was fired.
TrainingFrames::HostFrameArrays TrainingFrames::compute_arrays(std::size_t frame_index) const {
    const TrainingFrameData& data = frames_[frame_index];
    const TrainedFrame trained(log_, data.position, use_.grid);
    const Frame& frame = trained.frame;
    HostFrameArrays host;
    make_frame_arrays(log_, frame, use_.unknown, host.rays, host.targets);
    if (use_.moves_rays)
        for (const float offset_s : frame.scan.rays.time_offset_s) {
            const TrackInterpolation track_position =
                log_.world_from_vehicle.find_segment(firing_time_s(log_, frame, offset_s));
            host.track_positions.push_back({static_cast<std::uint32_t>(track_position.left - data.first_knot),
                                            static_cast<float>(track_position.s)});
        }
    return host;
}

/// Returns the prefetched arrays, or computes them if another frame was prefetched.
TrainingFrames::HostFrameArrays TrainingFrames::take_prefetched(std::size_t frame_index) {
    if (prefetched_frame_.valid()) {
        HostFrameArrays host = prefetched_frame_.get();
        if (prefetched_index_ == frame_index) return host;
    }
    return compute_arrays(frame_index);
}

TrainingFrameData& TrainingFrames::ensure_resident(Stream& stream, std::size_t frame_index) {
    TrainingFrameData& frame = frames_[frame_index];
    if (frame_index < n_staying_) return frame;  // uploaded by the constructor
    // The other frames share their arrays, so this replaces the frame that was there.
    const HostFrameArrays host = take_prefetched(frame_index);
    upload_values(stream, frame.arrays->rays, host.rays);
    upload_values(stream, frame.arrays->targets, host.targets);
    upload_values(stream, frame.arrays->track_positions, host.track_positions);
    count_rays(frame, host.targets);
    return frame;
}

void TrainingFrames::prefetch_frame(std::size_t frame_index) {
    if (frame_index < n_staying_ || (prefetched_frame_.valid() && prefetched_index_ == frame_index)) return;
    if (prefetched_frame_.valid()) prefetched_frame_.wait();
    prefetched_index_ = frame_index;
    prefetched_frame_ =
        std::async(std::launch::async, [this, frame_index] { return compute_arrays(frame_index); });
}

namespace {

// Minimum distance that a logit can move during training: the sum of the rates of all
// steps that can move it, before the rates decay. In SH coefficients; the constant
// coefficient is 3.5 times its part of the logit.
constexpr double kMinLogitMotion = 50.0;
constexpr double kMaxRate = 2.0;  // maximum rate, so that a single ray does not decide if a surfel returns

/// Returns how often training is expected to use a ray that hits a model, [models]: the
/// steps of each frame in which the model is present, times the share of rays in a batch.
std::vector<double> count_hitting_steps(const Scene& scene, std::span<const TrainingFrameData> frames,
                                        const TrainConfig& config) {
    std::vector<double> steps(scene.models.size(), 0.0);
    const double steps_per_frame = double(config.iterations) / double(frames.size());
    for (const TrainingFrameData& frame : frames) {
        const double n_rays = config.rays_per_iteration > 0 ? config.rays_per_iteration : frame.n_rays;
        const double ray_share = n_rays < frame.n_rays ? n_rays / frame.n_rays : 1.0;  // of a batch
        for (std::size_t i = 0; i < frame.placed.size(); ++i)
            if (frame.placed[i].present) steps[scene.instances[i].model] += steps_per_frame * ray_share;
    }
    return steps;
}

}  // namespace

std::vector<float> logit_factors(const Scene& scene, std::span<const TrainingFrameData> frames,
                                 const TrainConfig& config) {
    const std::vector<double> steps = count_hitting_steps(scene, frames, config);
    std::vector<float> factors;
    for (std::size_t model = 0; model < steps.size(); ++model) {
        const bool is_actor = scene.models[model].half_size_m.x > 0.0f;  // the background has no box
        // With this rate, a logit can move by kMinLogitMotion in all steps together.
        const double needed_rate = std::min(kMinLogitMotion / std::max(steps[model], 1.0), kMaxRate);
        factors.push_back(is_actor ? float(std::max(needed_rate / config.sh_rate, 1.0)) : 1.0f);
    }
    const auto is_one = [](float factor) { return factor == 1.0f; };
    if (std::ranges::all_of(factors, is_one)) factors.clear();
    return factors;
}

}  // namespace relidar
