// SPDX-License-Identifier: Apache-2.0
#include "gpu/check_device.hpp"

#include <algorithm>
#include <chrono>
#include <cmath>
#include <numeric>

#include <fmt/format.h>

#include "gpu/context.hpp"
#include "gpu/radix_sort.hpp"
#include "gpu/stream.hpp"
#include "gpu/trust.hpp"

namespace relidar {
namespace {

using Words = std::vector<std::uint32_t>;

/// Adds integers from 1 to RELIDAR_CHECK_AMOUNTS to `n_sums` sums: thread i to sum i %
/// n_sums. Floats represent them exactly. Returns the largest relative error of a sum.
double run_atomic_adds(Stream& stream, const Kernel<shared::CheckAtomicsParams>& kernel,
                       std::uint32_t n_threads, std::uint32_t n_sums, bool inject_fault,
                       double* elapsed_s = nullptr) {
    std::vector<double> expected(n_sums, 0.0);
    for (std::uint32_t i = 0; i < n_threads; ++i) expected[i % n_sums] += 1.0 + i % RELIDAR_CHECK_AMOUNTS;
    const Array<float> sums(stream.device(), std::vector<float>(n_sums, 0.0f), "sums");
    const auto start = std::chrono::steady_clock::now();
    run(stream, kernel, n_threads,
        {.sums = sums.address(), .n = n_threads, .n_sums = n_sums, .fault = inject_fault});
    stream.submit_and_wait();
    if (elapsed_s)
        *elapsed_s = std::chrono::duration<double>(std::chrono::steady_clock::now() - start).count();
    const std::vector<float> actual = sums.download();
    double worst = 0.0;
    for (std::uint32_t i = 0; i < n_sums; ++i) {
        const double error = std::abs(double(actual[i]) - expected[i]) / expected[i];
        worst = std::isfinite(error) ? std::max(worst, error) : HUGE_VAL;
    }
    return worst;
}

constexpr std::array<const char*, RELIDAR_CHECK_RESULTS> kOperationNames = {
    "gl_SubgroupSize",
    "subgroupAdd",
    "subgroupExclusiveAdd",
    "subgroupMax",
    "subgroupBallot",
    "subgroupShuffle",
    "functions subgroupAny and subgroupAll",
    "subgroupBroadcast",
    "function subgroupAdd in a branch",
    "prefix sum over a workgroup",
    "sum over a workgroup",
};
constexpr std::size_t kInBranch = 8;  // index of "subgroupAdd in a branch"
constexpr std::uint32_t kCheckWorkgroup = 256;

/// Values of the threads (lanes) of a subgroup.
struct SubgroupValues {
    Words lanes = {};
    std::uint32_t earlier_sum = 0;    ///< sum of all earlier subgroups of the workgroup
    std::uint32_t workgroup_sum = 0;  ///< sum of all its subgroups
};

/// Returns a thread's correct results of subgroup operations, ordered as kOperationNames.
std::array<std::uint32_t, RELIDAR_CHECK_RESULTS> expected_results(const SubgroupValues& subgroup,
                                                                  std::size_t lane) {
    const Words& lanes = subgroup.lanes;
    std::uint32_t sum = 0, sum_before_lane = 0, largest = 0, n_odd = 0, odd_sum = 0;
    for (std::size_t i = 0; i < lanes.size(); ++i) {
        const bool is_odd = lanes[i] & 1u;
        sum += lanes[i];
        if (i < lane) sum_before_lane += lanes[i];
        largest = std::max(largest, lanes[i]);
        if (is_odd) ++n_odd;
        if (is_odd) odd_sum += lanes[i];
    }
    const auto size = static_cast<std::uint32_t>(lanes.size());
    const std::uint32_t neighbour = lanes[lane ^ 1u];
    const std::uint32_t any_and_all_odd = (n_odd > 0 ? 1u : 0u) + (n_odd == size ? 2u : 0u);
    // Only lanes with odd values take the branch.
    const std::uint32_t branch_sum = lanes[lane] & 1u ? odd_sum : 0u;
    return {size,
            sum,
            sum_before_lane,
            largest,
            n_odd,
            neighbour,
            any_and_all_odd,
            lanes.front(),
            branch_sum,
            subgroup.earlier_sum + sum_before_lane,
            subgroup.workgroup_sum};
}

/// Returns a text about the first wrong result in a subgroup, or an empty text.
/// @param actual  results of the device, [lanes, RELIDAR_CHECK_RESULTS]
/// @param reconverges false: does not test the sum in a branch, because it is undefined
std::string find_wrong_result(const SubgroupValues& subgroup, const std::uint32_t* actual, bool reconverges) {
    for (std::size_t lane = 0; lane < subgroup.lanes.size(); ++lane) {
        const auto expected = expected_results(subgroup, lane);
        for (std::size_t k = 0; k < expected.size(); ++k) {
            const std::uint32_t found = actual[lane * RELIDAR_CHECK_RESULTS + k];
            if (found != expected[k] && (k != kInBranch || reconverges))
                return fmt::format("{}: found {} in lane {}, expected {}", kOperationNames[k], found, lane,
                                   expected[k]);
        }
    }
    return {};
}

/// Compares the results of all subgroup operations with the host's results. Thread i of
/// the launch has the value test_value(i), which both compute. Returns a text about the
/// first wrong result, or an empty text.
std::string run_subgroup_test(Device& device) {
    const Kernel<shared::CheckSubgroupsParams> kernel(
        device, "gpu/check_subgroups", {{SpecialisationConstantId::WORKGROUP_SIZE, kCheckWorkgroup}},
        SubgroupRequirement::full);
    constexpr std::uint32_t kCheckThreads = 16 * kCheckWorkgroup;
    const Array<std::uint32_t> results(device, kCheckThreads * RELIDAR_CHECK_RESULTS, "results of subgroups");
    Stream stream(device);
    const bool fault = gpu::has_fault(fmt::format("subgroups:{}", device.info().subgroup_size));
    run(stream, kernel, kCheckThreads, {.results = results.address(), .fault = fault});
    stream.submit_and_wait();
    const Words actual = results.download();
    const auto n_lanes = static_cast<std::uint32_t>(device.info().subgroup_size);
    // Each workgroup starts at `first_thread`, and each of its subgroups at `first_lane`.
    for (std::uint32_t first_thread = 0; first_thread < kCheckThreads; first_thread += kCheckWorkgroup) {
        SubgroupValues subgroup;
        for (std::uint32_t i = 0; i < kCheckWorkgroup; ++i)
            subgroup.workgroup_sum += shared::test_value(first_thread + i);
        for (std::uint32_t first_lane = first_thread; first_lane < first_thread + kCheckWorkgroup;
             first_lane += n_lanes) {
            subgroup.lanes.clear();
            for (std::uint32_t i = 0; i < n_lanes; ++i)
                subgroup.lanes.push_back(shared::test_value(first_lane + i));
            const std::string error = find_wrong_result(
                subgroup, actual.data() + first_lane * RELIDAR_CHECK_RESULTS, lanes_reconverge(device));
            if (!error.empty()) return error;
            subgroup.earlier_sum =
                std::accumulate(subgroup.lanes.begin(), subgroup.lanes.end(), subgroup.earlier_sum);
        }
    }
    return {};
}

/// Sorts 5000 keys on the device, more than one tile. Returns an empty text if the order
/// is right, otherwise a text about the first wrong key.
std::string run_sort_test(Device& device) {
    if (!device.info().can_require_subgroup_size) return {};  // relidar never sorts on such a device
    constexpr std::uint32_t kCheckKeys = 5000;
    Words keys(kCheckKeys);
    for (std::uint32_t i = 0; i < kCheckKeys; ++i) keys[i] = shared::test_value(i);
    static_assert(kCheckKeys > RELIDAR_TILE_SIZE);
    const Array<std::uint32_t, shared::SortKeys> first(device, std::span<const std::uint32_t>(keys), "keys"),
        second(device, kCheckKeys, "keys");
    const Array<std::uint32_t, shared::SortOrder> first_order(device, kCheckKeys, "order"),
        second_order(device, kCheckKeys, "order");
    constexpr std::uint32_t kWordsPerKey = 1, kKeyBits = 16;
    const RadixSort sort(device, kCheckKeys, kWordsPerKey);
    Stream stream(device);
    sort.run(stream, {first.address(), first_order.address()}, {second.address(), second_order.address()},
             kKeyBits);
    stream.submit_and_wait();
    std::ranges::sort(keys);
    const Words actual = first.download();  // 16 bits need two passes, so the first buffer has the result
    const auto [found, expected] = std::ranges::mismatch(actual, keys);
    if (found == actual.end()) return {};
    return fmt::format("sort of {} keys: found key {} at position {}, expected {}", kCheckKeys, *found,
                       found - actual.begin(), *expected);
}

}  // namespace

double test_atomic_adds(Device& device, AtomicAddMethod method) {
    const bool is_swap = method == AtomicAddMethod::compare_and_swap;
    const Kernel<shared::CheckAtomicsParams> kernel(device, "gpu/check_atomics",
                                                    KernelVariant(is_swap ? "@_swap" : "@_atomics"));
    const bool fault = gpu::has_fault(is_swap ? "float_swaps" : "float_atomics");
    Stream stream(device);
    return std::max(run_atomic_adds(stream, kernel, 1u << 18, 1024, fault),
                    run_atomic_adds(stream, kernel, 1u << 14, 1, fault));
}

double test_swap_adds(Device& device, std::uint32_t n_threads, double& elapsed_s) {
    const Kernel<shared::CheckAtomicsParams> kernel(device, "gpu/check_atomics", KernelVariant("@_swap"));
    Stream stream(device);
    const double piece_s = std::exchange(device.impl().launch_limit.piece_s, 0.0);
    const double error = run_atomic_adds(stream, kernel, n_threads, 1024, false, &elapsed_s);
    device.impl().launch_limit.piece_s = piece_s;
    return error;
}

/// Returns the subgroup sizes that a kernel can require: powers of two, 4 to 64. If it
/// cannot require a size, returns the size that the driver uses.
std::vector<int> subgroup_sizes(const Device& device) {
    if (!device.impl().optional.subgroup_size) return {device.info().subgroup_size};
    const gpu::DeviceProperties properties(device.impl().physical);
    std::vector<int> result;
    for (std::uint32_t lanes = 4; lanes <= 64; lanes *= 2)
        if (lanes >= properties.subgroup_sizes.minSubgroupSize &&
            lanes <= properties.subgroup_sizes.maxSubgroupSize)
            result.push_back(static_cast<int>(lanes));
    return result;
}

std::string test_subgroups(Device& device) {
    const std::string wrong = run_subgroup_test(device);
    return wrong.empty() ? run_sort_test(device) : wrong;
}

}  // namespace relidar
