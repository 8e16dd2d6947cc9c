// SPDX-License-Identifier: Apache-2.0
#include "ranks.hpp"
#include "base/fail.hpp"

#include <chrono>
#include <exception>
#include <fstream>
#include <limits>
#include <numeric>
#include <thread>

#include <mpi.h>

#include <relidar/gpu/device.hpp>
#include <relidar/log/sensor.hpp>
#include "console.hpp"

namespace relidar::cli {
namespace {

/// Tests every 20 ms whether a request is done. MPI_Wait would keep a core busy.
void wait_for_mpi(MPI_Request request) {
    for (int done = 0; !done; std::this_thread::sleep_for(std::chrono::milliseconds(done ? 0 : 20)))
        MPI_Test(&request, &done, MPI_STATUS_IGNORE);
}

/// Returns a hash (FNV-1a, with the constants of its 64-bit version) of the program file,
/// or 0 if the file cannot be read. Two processes with the same hash run the same build.
unsigned long long hash_program() {
    std::ifstream program("/proc/self/exe", std::ios::binary);
    unsigned long long hash = 14695981039346656037ull;
    std::vector<char> block(1 << 20);
    while (program.read(block.data(), std::streamsize(block.size())) || program.gcount() > 0)
        for (std::streamsize i = 0; i < program.gcount(); ++i)
            hash = (hash ^ static_cast<unsigned char>(block[std::size_t(i)])) * 1099511628211ull;
    return program.bad() || !program.eof() ? 0 : hash;
}

/// Checks that all MPI processes run the same build, because other builds may store
/// settings and arrays in a different order.
/// @throws UsageError if the build differs from that of the first process
void check_same_build(int rank) {
    const unsigned long long build = hash_program();
    unsigned long long first_build = build;
    MPI_Bcast(&first_build, 1, MPI_UNSIGNED_LONG_LONG, 0, MPI_COMM_WORLD);
    if (build != first_build)
        fail<UsageError>("MPI process {} runs a different build of relidar than the first process", rank);
}

/// Concatenates the texts of all MPI processes in the order of their ranks. Every process
/// receives the complete text.
std::string gather_text(const std::string& text, int n_ranks) {
    // The processes exchange their sizes, and then their texts.
    const auto n = static_cast<unsigned long long>(text.size());
    std::vector<unsigned long long> sizes(static_cast<std::size_t>(n_ranks));
    MPI_Request request;
    MPI_Iallgather(&n, 1, MPI_UNSIGNED_LONG_LONG, sizes.data(), 1, MPI_UNSIGNED_LONG_LONG, MPI_COMM_WORLD,
                   &request);
    wait_for_mpi(request);
    const unsigned long long total = std::accumulate(sizes.begin(), sizes.end(), 0ull);
    // MPI stores the number of bytes as int, so texts of more than 2 GiB are rejected.
    if (total > static_cast<unsigned long long>(std::numeric_limits<int>::max()))
        throw Error(
            ExitCode::bug,
            "cannot collect the results of the MPI processes: they exceed 2 GiB; expected at most 2 GiB");
    // The text of a rank begins at its displacement in the joined text.
    std::vector<int> counts(sizes.begin(), sizes.end()), displacements(sizes.size());
    std::exclusive_scan(counts.begin(), counts.end(), displacements.begin(), 0);
    std::string all(total, '\0');
    MPI_Iallgatherv(text.data(), static_cast<int>(n), MPI_CHAR, all.data(), counts.data(),
                    displacements.data(), MPI_CHAR, MPI_COMM_WORLD, &request);
    wait_for_mpi(request);
    return all;
}

}  // namespace

/// Joins the group of processes that mpirun has started.
MpiProcessGroup::MpiProcessGroup() {
    if (!is_mpi_process()) return;
    MPI_Init(nullptr, nullptr);
    MPI_Comm_rank(MPI_COMM_WORLD, &group_.rank);
    MPI_Comm_size(MPI_COMM_WORLD, &group_.size);
    group_.all_gather = [size = group_.size](const std::string& text) { return gather_text(text, size); };
    // The processes of this machine share its memory and its GPUs.
    MPI_Comm on_this_machine;
    MPI_Comm_split_type(MPI_COMM_WORLD, MPI_COMM_TYPE_SHARED, group_.rank, MPI_INFO_NULL, &on_this_machine);
    MPI_Comm_rank(on_this_machine, &local_rank_);
    int n_here = 1;
    MPI_Comm_size(on_this_machine, &n_here);
    MPI_Comm_free(&on_this_machine);
    share_scan_memory(n_here);
    check_same_build(group_.rank);
    // Only the first process prints notes and warnings.
    const bool is_hidden = group_.rank > 0;
    if (is_hidden) set_quiet(is_hidden, is_hidden);
}

MpiProcessGroup::~MpiProcessGroup() {
    int begun = 0;
    MPI_Initialized(&begun);
    if (begun && std::uncaught_exceptions() == 0) MPI_Finalize();
}

void MpiProcessGroup::barrier() const {
    if (size() == 1) return;
    MPI_Request request;
    MPI_Ibarrier(MPI_COMM_WORLD, &request);
    wait_for_mpi(request);
}

std::vector<std::string> MpiProcessGroup::gather_texts(const std::string& text) const {
    if (size() == 1) return {text};
    // The sizes show where each text begins in the joined text.
    const std::vector<std::size_t> sizes = group_.gather(std::vector{text.size()});
    const std::string all = group_.all_gather(text);
    if (!is_first()) return {};
    std::vector<std::string> texts;
    std::size_t begin = 0;
    for (const std::size_t n : sizes) {
        texts.push_back(all.substr(begin, n));
        begin += n;
    }
    return texts;
}

DeviceCommandOptions MpiProcessGroup::select_device(DeviceCommandOptions user_device_choice) const {
    if (size() == 1 || user_device_choice.index >= 0) return user_device_choice;
    std::vector<int> gpus;
    for (const DeviceInfo& device : list_devices())
        if (device.type != "CPU" && device.why_not_usable.empty()) gpus.push_back(device.index);
    if (!gpus.empty()) user_device_choice.index = gpus[std::size_t(local_rank_) % gpus.size()];
    return user_device_choice;
}

}  // namespace relidar::cli
