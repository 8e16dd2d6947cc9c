// SPDX-License-Identifier: Apache-2.0
// Measures the copy bandwidth with the kernel gpu/copy and with the driver's copy
// command.
#include "gpu/copy_rate.hpp"

#include <algorithm>
#include <chrono>

#include <relidar/base/error.hpp>
#include <relidar/gpu/out_of_memory.hpp>

#include "gpu/kernel.hpp"
#include "gpu/shared/gpu.h"
#include "gpu/stream.hpp"

namespace relidar {
namespace {

/// Copies `n_vectors` vectors (16 bytes each) several times. Alternates between a copy
/// kernel and the driver's copy command, because either can be faster. A GPU raises its
/// clock only under load, so the copies of a round run without pauses.
/// @return duration of the fastest copy in seconds
double fastest_copy_s(Device& device, std::size_t n_vectors) {
    const Array<glm::vec4, shared::CopySource> from(device, n_vectors, "source of a test copy");
    const Array<glm::vec4, shared::CopyTarget> to(device, n_vectors, "target of a test copy");
    const Kernel<shared::CopyParams> copy(device, "gpu/copy",
                                          {{SpecialisationConstantId::WORKGROUP_SIZE, 256u}});
    Stream stream(device, true);
    stream.fill(from);
    stream.submit_and_wait();
    constexpr int kCopyRounds = 8, kCopiesPerRound = 8;
    constexpr double kMaxCopyTime_s = 0.25;
    using Clock = std::chrono::steady_clock;
    const auto seconds_since = [](Clock::time_point start) {
        return std::chrono::duration<double>(Clock::now() - start).count();
    };
    const Clock::time_point begin = Clock::now();
    double fastest_s = 1e30;
    for (int round = 0; round < kCopyRounds; ++round) {
        const bool has_run_both = round > 1;  // a CPU device then stops, because its copies are slow
        if (has_run_both && seconds_since(begin) > kMaxCopyTime_s) break;
        const Clock::time_point start = Clock::now();
        for (int k = 0; k < kCopiesPerRound; ++k) {
            if (round % 2 == 0)
                run(stream, copy, n_vectors,
                    {.from = from.address(), .to = to.address(), .n = static_cast<std::uint32_t>(n_vectors)});
            else stream.copy(from.buffer(), to.buffer(), n_vectors * sizeof(glm::vec4));
        }
        stream.submit_and_wait();
        fastest_s = std::min(fastest_s, seconds_since(start) / kCopiesPerRound);
    }
    // Timestamps are more precise, because they exclude submissions and waits.
    if (!device.info().timestamps) return fastest_s;
    const auto times_ms = stream.times().milliseconds;
    return std::min(std::ranges::min(times_ms.at("gpu/copy")), std::ranges::min(times_ms.at("copy"))) /
           1000.0;
}

}  // namespace

std::optional<double> measure_bandwidth(Device& device) {
    constexpr std::size_t kMiB = std::size_t(1) << 20;
    for (std::size_t n_bytes = 256 * kMiB; n_bytes >= kMiB; n_bytes /= 4) {
        try {
            return 2.0 * static_cast<double>(n_bytes) / fastest_copy_s(device, n_bytes / sizeof(glm::vec4));
        } catch (const OutOfDeviceMemory&) {}
    }
    return std::nullopt;
}

}  // namespace relidar
