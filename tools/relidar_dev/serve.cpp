// SPDX-License-Identifier: Apache-2.0
#include "serve.hpp"

#include <fmt/format.h>

#include <relidar/base/error.hpp>
#include "../network/host_port.hpp"
#include "../serve/latency.hpp"
#include "base/fail.hpp"
#include "console.hpp"

namespace relidar::cli {
namespace {

constexpr int kMostClients = 256, kMostCalls = 1'000'000;

}  // namespace

void bench_service(const ServeBenchOptions& options) {
    if (options.clients < 1 || options.clients > kMostClients)
        fail<UsageError>("--clients: found {}, expected a number from 1 to {}", options.clients,
                         kMostClients);
    if (options.calls < 1 || options.calls > kMostCalls)
        fail<UsageError>("--calls: found {}, expected a number from 1 to {}", options.calls, kMostCalls);
    (void)parse_host_port(options.address, "--serve", 1);
    const serve::LatencyResult r = serve::measure_latency(
        {options.address, options.scene, options.sensor, options.clients, options.calls});
    const auto row = [](const char* name, const serve::Percentiles& p) -> std::vector<std::string> {
        return {name, fmt::format("{:.1f}", p.p50), fmt::format("{:.1f}", p.p99)};
    };
    print(fmt::format(
        "{} at {}: {} calls by {} clients, {} rays and {:.0f} points per scan\n{}{:.1f} scans/s\n", r.scene,
        options.address, options.calls, options.clients, r.rays, r.points,
        format_table({{"ms", "p50", "p99"},
                      row("latency", r.latency_ms),
                      row("waiting in the queue", r.queued_ms),
                      row("rendering", r.rendered_ms)}),
        r.scans_per_s));
}

}  // namespace relidar::cli
