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

/// Copies `n_vectors` vectors several times and returns the duration of the fastest copy
/// in seconds. Alternates between a copy kernel and the driver's copy command, because
/// either can be faster. A GPU raises its clock only under load, so the copies run
/// without pauses. A CPU device runs each kind only once, because a copy takes seconds
/// there.
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
    const auto begin = std::chrono::steady_clock::now();
    double best = 1e30;
    for (int i = 0; i < kCopyRounds; ++i) {
        const auto start = std::chrono::steady_clock::now();
        if (i > 1 && std::chrono::duration<double>(start - begin).count() > kMaxCopyTime_s) break;
        for (int k = 0; k < kCopiesPerRound; ++k) {
            if (i % 2 == 0)
                run(stream, copy, n_vectors,
                    {.from = from.address(), .to = to.address(), .n = static_cast<std::uint32_t>(n_vectors)});
            else stream.copy(from.buffer(), to.buffer(), n_vectors * sizeof(glm::vec4));
        }
        stream.submit_and_wait();
        best =
            std::min(best, std::chrono::duration<double>(std::chrono::steady_clock::now() - start).count() /
                               kCopiesPerRound);
    }
    if (!device.info().timestamps) return best;
    const auto times = stream.times().milliseconds;
    return std::min(std::ranges::min(times.at("gpu/copy")), std::ranges::min(times.at("copy"))) / 1000.0;
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
