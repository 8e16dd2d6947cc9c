// SPDX-License-Identifier: Apache-2.0
// Checks that large allocations keep their contents. The checks use nine tenths of the
// free GPU memory, so that other programs can still allocate memory. On a CPU device,
// they use at most an eighth, because the host needs the memory.
#include <algorithm>
#include <memory>
#include <vector>

#include <fmt/format.h>

#include "check/checks.hpp"
#include "console.hpp"
#include "gpu/context.hpp"
#include "gpu/memory.hpp"

namespace relidar::cli {
namespace {

constexpr std::uint64_t kMiB = std::uint64_t(1) << 20;

/// Returns how many bytes of device memory each check in this file may allocate.
std::uint64_t memory_budget_bytes(const Device& device) {
    std::uint64_t n_free = gpu::query_budget(device.impl().physical).free_bytes();
    if (const std::uint64_t limit = device.impl().memory_limit_bytes; limit > 0)
        n_free = std::min(n_free, limit - std::min(limit, device.allocated_bytes()));
    return device.info().type == "CPU" ? std::min(n_free / 8, 2048 * kMiB) : n_free / 10 * 9;
}

/// Looks only at the first and the last 16 words.
bool is_filled_with(const Buffer& buffer, std::uint32_t expected_word) {
    std::uint32_t words[16];
    for (const std::size_t offset : {std::size_t(0), buffer.size_bytes() - sizeof words}) {
        buffer.download(words, sizeof words, offset);
        if (std::ranges::any_of(words, [&](std::uint32_t word) { return word != expected_word; }))
            return false;
    }
    return true;
}

}  // namespace

/// Fills the largest buffer that the driver and the free memory allow. Reads both ends.
CheckResult check_buffer(CheckedDevice& tested) {
    Device& device = tested.default_device();
    constexpr std::uint32_t kPattern = 0x5a5a1234u;
    // Multiples of 64 bytes, because is_filled_with() reads so many at both ends.
    const std::uint64_t limit = device.impl().largest_buffer.n_bytes / 64 * 64,
                        n_bytes = std::min(limit, memory_budget_bytes(device) / 64 * 64);
    if (n_bytes < kMiB) return unsupported_check("less than 1 MiB of device memory is free");
    const Buffer buffer(device, n_bytes, "the largest buffer");
    Stream stream(device);
    stream.fill(buffer, kPattern);
    stream.submit_and_wait();
    if (!is_filled_with(buffer, kPattern))
        return failed_check(fmt::format("a buffer of {} does not contain the values that were written to it",
                                        format_bytes(n_bytes)));
    const std::string remark = n_bytes == limit ? ", which is the limit of the device"
                                                : " tested; the driver allows at most " + format_bytes(limit);
    return passed_check(format_bytes(n_bytes) + remark);
}

/// Fills the allowed memory with buffers of different values before it reads them.
/// Overlapping buffers would then have wrong values.
CheckResult check_memory(CheckedDevice& tested) {
    Device& device = tested.default_device();
    constexpr std::uint64_t kPieceBytes = 256 * kMiB;
    const std::uint64_t allowed = memory_budget_bytes(device);
    std::vector<std::unique_ptr<Buffer>> pieces;
    Stream stream(device);
    while ((pieces.size() + 1) * kPieceBytes <= allowed) {
        pieces.push_back(std::make_unique<Buffer>(device, kPieceBytes, "memory of the check"));
        stream.fill(*pieces.back(), static_cast<std::uint32_t>(pieces.size()));
    }
    stream.submit_and_wait();
    if (pieces.empty()) return unsupported_check("the driver allows less than 256 MiB of device memory");
    for (std::size_t i = 0; i < pieces.size(); ++i)
        if (!is_filled_with(*pieces[i], static_cast<std::uint32_t>(i + 1)))
            return failed_check(fmt::format(
                "buffer {} of {} does not contain the values that were written to it", i + 1, pieces.size()));
    return passed_check(fmt::format("{} of memory tested, of {} that the driver allows to use",
                                    format_bytes(pieces.size() * kPieceBytes),
                                    format_bytes(gpu::query_budget(device.impl().physical).n_bytes)));
}

}  // namespace relidar::cli
