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

void bench_service(const ServeBenchOptions& bench_options) {
    if (bench_options.clients < 1 || bench_options.clients > kMostClients)
        fail<UsageError>("--clients: found {}, expected a number from 1 to {}", bench_options.clients,
                         kMostClients);
    if (bench_options.calls < 1 || bench_options.calls > kMostCalls)
        fail<UsageError>("--calls: found {}, expected a number from 1 to {}", bench_options.calls,
                         kMostCalls);
    (void)parse_host_port(bench_options.address, "--serve", 1);
    const serve::LatencyResult r =
        serve::measure_latency({bench_options.address, bench_options.scene, bench_options.sensor,
                                bench_options.clients, bench_options.calls});
    const auto row = [](const char* name, const serve::Percentiles& p) -> std::vector<std::string> {
        return {name, fmt::format("{:.1f}", p.p50), fmt::format("{:.1f}", p.p99)};
    };
    print(fmt::format(
        "{} at {}: {} calls by {} clients, {} rays and {:.0f} points per scan\n{}{:.1f} scans/s\n", r.scene,
        bench_options.address, bench_options.calls, bench_options.clients, r.rays, r.points,
        format_table({{"ms", "p50", "p99"},
                      row("latency", r.latency_ms),
                      row("waiting in the queue", r.queued_ms),
                      row("rendering", r.rendered_ms)}),
        r.scans_per_s));
}

}  // namespace relidar::cli
