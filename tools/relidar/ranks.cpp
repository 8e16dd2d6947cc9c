// SPDX-License-Identifier: Apache-2.0
#include "ranks.hpp"

#include <chrono>
#include <exception>
#include <thread>

#include <mpi.h>

#include "launched_by_mpi.hpp"
#include <relidar/gpu.hpp>

namespace relidar::cli {

Ranks::Ranks() {
    if (!launched_by_mpi()) return;
    MPI_Init(nullptr, nullptr);
    MPI_Comm_rank(MPI_COMM_WORLD, &rank_);
    MPI_Comm_size(MPI_COMM_WORLD, &size_);
    MPI_Comm on_this_machine;
    MPI_Comm_split_type(MPI_COMM_WORLD, MPI_COMM_TYPE_SHARED, rank_, MPI_INFO_NULL, &on_this_machine);
    MPI_Comm_rank(on_this_machine, &local_rank_);
    MPI_Comm_free(&on_this_machine);
}

Ranks::~Ranks() {
    int begun = 0;
    MPI_Initialized(&begun);
    if (begun && std::uncaught_exceptions() == 0) MPI_Finalize();
}

void Ranks::wait_for_all() const {
    if (size_ == 1) return;
    MPI_Request request;
    MPI_Ibarrier(MPI_COMM_WORLD, &request);
    for (int done = 0; !done; std::this_thread::sleep_for(std::chrono::milliseconds(done ? 0 : 20)))   // MPI_Barrier would spin
        MPI_Test(&request, &done, MPI_STATUS_IGNORE);
}

DeviceChoice Ranks::device(DeviceChoice chosen) const {
    if (size_ == 1 || chosen.index >= 0) return chosen;
    std::vector<int> gpus;
    for (const DeviceInfo& device : list_devices())
        if (device.type != "CPU" && device.why_not_usable.empty()) gpus.push_back(device.index);
    if (!gpus.empty()) chosen.index = gpus[std::size_t(local_rank_) % gpus.size()];
    return chosen;
}

}  // namespace relidar::cli
