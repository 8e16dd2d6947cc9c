// SPDX-License-Identifier: Apache-2.0
#include "latency.hpp"

#include <algorithm>
#include <atomic>
#include <chrono>
#include <cmath>
#include <exception>
#include <mutex>
#include <thread>
#include <vector>

#include "base/fail.hpp"

#include "client.hpp"

namespace relidar::serve {
namespace {

using Clock = std::chrono::steady_clock;

struct LatencySample {
    double latency_ms, queued_ms, rendered_ms;
    std::size_t rays, points;
};

/// Returns the smallest value that at least this share of all values does not exceed
/// (nearest-rank method).
double percentile(std::vector<double> values, double percentile_as_fraction) {
    std::sort(values.begin(), values.end());
    const auto rank = std::size_t(std::ceil(percentile_as_fraction * double(values.size())));
    return values[std::max<std::size_t>(rank, 1) - 1];
}

Percentiles percentiles(const std::vector<LatencySample>& samples, double LatencySample::*time_member) {
    std::vector<double> values;
    for (const LatencySample& sample : samples) values.push_back(sample.*time_member);
    return {percentile(values, 0.5), percentile(values, 0.99)};
}

/// A sweep between two successive poses of the log, starting again after the last pose.
v1::RenderLidarRequest sweep_request(const LatencyOptions& options, const std::string& scene_name,
                                     const v1::GetTracksResponse& tracks, int number) {
    v1::RenderLidarRequest request;
    request.set_scene(scene_name);
    if (!options.sensor.empty()) request.mutable_sensor()->set_name(options.sensor);
    const int n = tracks.dataset_from_sensor_size(), first = n > 1 ? number % (n - 1) : 0;
    for (int i = first; i < std::min(first + 2, n); ++i) *request.add_path() = tracks.dataset_from_sensor(i);
    request.mutable_wanted()->set_points(true);
    return request;
}

using Stub = v1::RenderService::Stub;

template <class Answer>
Answer checked(const Reply<Answer>& reply) {
    if (!reply.status.ok())
        fail("the service returned status {}: {}", int(reply.status.error_code()),
             reply.status.error_message());
    return reply.answer;
}

LatencySample measure_render(Stub& service, const v1::RenderLidarRequest& request) {
    const Clock::time_point begin = Clock::now();
    const v1::LidarScan scan = checked(call(service, &Stub::RenderLidar, request));
    const double latency_ms = std::chrono::duration<double, std::milli>(Clock::now() - begin).count();
    return {latency_ms, scan.queued_ms(), scan.rendered_ms(), std::size_t(scan.rays()),
            scan.points().count()};
}

}  // namespace

/// Measures the latency of a render service. Each client is a thread with its own
/// connection and sends its next call when the previous response has arrived.
LatencyResult measure_latency(const LatencyOptions& options) {
    Stub first(open_channel(options.address));
    const v1::ListScenesResponse scenes = checked(call(first, &Stub::ListScenes, {}));
    if (scenes.scenes().empty())
        fail("the service at {} serves no scene, expected at least one", options.address);
    LatencyResult result;
    result.scene = options.scene.empty() ? scenes.scenes(0).name() : options.scene;
    v1::GetTracksRequest which;
    which.set_scene(result.scene);
    const v1::GetTracksResponse tracks = checked(call(first, &Stub::GetTracks, which));
    // The first call is not measured. It takes longer, because it computes the rays of
    // the sensor and allocates memory.
    measure_render(first, sweep_request(options, result.scene, tracks, 0));

    std::vector<LatencySample> samples;
    std::exception_ptr failure;
    std::mutex mutex;
    std::atomic<int> next = 0;
    const Clock::time_point begin = Clock::now();
    {
        std::vector<std::jthread> clients;
        for (int c = 0; c < options.clients; ++c)
            clients.emplace_back([&] {
                try {
                    Stub client(open_channel(options.address));
                    // All clients share one counter, so faster clients send more calls.
                    for (int number = next++; number < options.calls; number = next++) {
                        const LatencySample sample =
                            measure_render(client, sweep_request(options, result.scene, tracks, number));
                        const std::lock_guard lock(mutex);
                        samples.push_back(sample);
                    }
                } catch (...) {
                    const std::lock_guard lock(mutex);
                    failure = std::current_exception();
                }
            });
    }
    if (failure) std::rethrow_exception(failure);
    result.scans_per_s = double(samples.size()) / std::chrono::duration<double>(Clock::now() - begin).count();
    result.latency_ms = percentiles(samples, &LatencySample::latency_ms);
    result.queued_ms = percentiles(samples, &LatencySample::queued_ms);
    result.rendered_ms = percentiles(samples, &LatencySample::rendered_ms);
    result.rays = samples.front().rays;
    for (const LatencySample& sample : samples)
        result.points += double(sample.points) / double(samples.size());
    return result;
}

}  // namespace relidar::serve
