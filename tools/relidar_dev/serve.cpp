// SPDX-License-Identifier: Apache-2.0
// Measures the latency of a render service.
#include "serve.hpp"

#include <algorithm>
#include <atomic>
#include <chrono>
#include <cmath>
#include <exception>
#include <mutex>
#include <thread>
#include <vector>

#include <fmt/format.h>

#include <relidar/base/error.hpp>
#include "../network/host_port.hpp"
#include "../serve/client.hpp"
#include "base/fail.hpp"
#include "console.hpp"
#include "measure.hpp"

namespace relidar::cli {
namespace {

constexpr int kMostClients = 256, kMostCalls = 1'000'000;

using Stub = v1::RenderService::Stub;

struct LatencySample {
    double latency_ms;   ///< Time from sending a call until the client receives the response.
    double queued_ms;    ///< Part of the latency during which the call waited in the queue.
    double rendered_ms;  ///< Part of the latency during which the scan was rendered.
    std::size_t rays, points;
};

/// Returns the row of a table: the smallest values that at least 50 % or 99 % of all
/// values do not exceed (nearest-rank method).
std::vector<std::string> percentile_row(const char* name, const std::vector<LatencySample>& samples,
                                        double LatencySample::*time_member) {
    std::vector<double> values;
    for (const LatencySample& sample : samples) values.push_back(sample.*time_member);
    std::ranges::sort(values);
    const auto percentile = [&](double share) {
        const auto rank = std::size_t(std::ceil(share * double(values.size())));
        return fmt::format("{:.1f}", values[std::max<std::size_t>(rank, 1) - 1]);
    };
    return {name, percentile(0.5), percentile(0.99)};
}

template <class Answer>
Answer checked_answer(const ServeBenchOptions& options, const serve::Reply<Answer>& reply) {
    if (!reply.status.ok())
        fail("the service at {} returned status {}: {}", options.address, int(reply.status.error_code()),
             reply.status.error_message());
    return reply.answer;
}

/// Returns call `number` of all clients: a scan while the sensor moves from a pose of the
/// log to the next pose. After the last pose, starts again with the first pose.
v1::RenderLidarRequest sweep_request(const ServeBenchOptions& options, const std::string& scene_name,
                                     const v1::GetTracksResponse& tracks, int number) {
    v1::RenderLidarRequest request;
    request.set_scene(scene_name);
    if (!options.sensor.empty()) request.mutable_sensor()->set_name(options.sensor);
    const int n_poses = tracks.dataset_from_sensor_size(), first = n_poses > 1 ? number % (n_poses - 1) : 0;
    for (int i = first; i < std::min(first + 2, n_poses); ++i)
        *request.add_path() = tracks.dataset_from_sensor(i);
    request.mutable_wanted()->set_points(true);
    return request;
}

/// Sends all calls by several clients and returns the times of each call. A client is a
/// thread with its own connection. It waits for a response before its next call.
std::vector<LatencySample> measure_calls(const ServeBenchOptions& options, const std::string& scene,
                                         const v1::GetTracksResponse& tracks) {
    const auto render = [&](Stub& service, int number) -> LatencySample {
        const auto begin = std::chrono::steady_clock::now();
        const v1::LidarScan scan = checked_answer(
            options, serve::call(service, &Stub::RenderLidar, sweep_request(options, scene, tracks, number)));
        return {ms_since(begin), scan.queued_ms(), scan.rendered_ms(), scan.rays(), scan.points().count()};
    };
    std::vector<LatencySample> samples;
    std::exception_ptr failure;
    std::mutex mutex;  // protects both
    std::atomic<int> next_call = 0;
    const auto run_client = [&] {
        try {
            Stub service(serve::open_channel(options.address));
            // All clients share one counter, so faster clients send more calls.
            for (int number = next_call++; number < options.calls; number = next_call++) {
                const LatencySample sample = render(service, number);
                const std::lock_guard lock(mutex);
                samples.push_back(sample);
            }
        } catch (...) {
            const std::lock_guard lock(mutex);
            failure = std::current_exception();
        }
    };
    std::vector<std::jthread> clients;
    for (int i = 0; i < options.clients; ++i) clients.emplace_back(run_client);
    clients.clear();  // Waits for all threads.
    if (failure) std::rethrow_exception(failure);
    return samples;
}

}  // namespace

void bench_service(const ServeBenchOptions& options) {
    if (options.clients < 1 || options.clients > kMostClients)
        fail<UsageError>("--clients: found {}, expected a number from 1 to {}", options.clients,
                         kMostClients);
    if (options.calls < 1 || options.calls > kMostCalls)
        fail<UsageError>("--calls: found {}, expected a number from 1 to {}", options.calls, kMostCalls);
    (void)parse_host_port(options.address, "--serve", 1);  // Called only for its error.

    Stub service(serve::open_channel(options.address));
    const v1::ListScenesResponse scenes =
        checked_answer(options, serve::call(service, &Stub::ListScenes, {}));
    if (scenes.scenes().empty())
        fail("the service at {} serves no scene, expected at least one", options.address);
    const std::string scene = options.scene.empty() ? scenes.scenes(0).name() : options.scene;
    v1::GetTracksRequest tracks_request;
    tracks_request.set_scene(scene);
    const v1::GetTracksResponse tracks =
        checked_answer(options, serve::call(service, &Stub::GetTracks, tracks_request));
    // The first call is not measured. It takes longer, because it computes the rays of
    // the sensor and allocates memory.
    checked_answer(options,
                   serve::call(service, &Stub::RenderLidar, sweep_request(options, scene, tracks, 0)));
    const auto begin = std::chrono::steady_clock::now();
    const std::vector<LatencySample> samples = measure_calls(options, scene, tracks);
    const double scans_per_s = 1000.0 * double(samples.size()) / ms_since(begin);

    double mean_points = 0.0;
    for (const LatencySample& sample : samples) mean_points += double(sample.points) / double(samples.size());
    print(fmt::format(
        "{} at {}: {} calls by {} clients, {} rays and {:.0f} points per scan\n{}{:.1f} scans/s\n", scene,
        options.address, options.calls, options.clients, samples.front().rays, mean_points,
        format_table({{"ms", "p50", "p99"},
                      percentile_row("latency", samples, &LatencySample::latency_ms),
                      percentile_row("waiting in the queue", samples, &LatencySample::queued_ms),
                      percentile_row("rendering", samples, &LatencySample::rendered_ms)}),
        scans_per_s));
}

}  // namespace relidar::cli
