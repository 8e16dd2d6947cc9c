// SPDX-License-Identifier: Apache-2.0
// Group of processes that work together on one task, like the ranks of an MPI program.
#pragma once

#include <cstddef>
#include <cstring>
#include <functional>
#include <string>
#include <type_traits>
#include <vector>

namespace relidar {

/// Group of processes that execute the same steps in the same order. A slow step is split
/// into parts. Each process computes some of the parts and then receives the results of
/// all parts. The number of processes does not affect how a step is split.
struct ProcessGroup {
    int rank = 0, size = 1;
    /// Function that joins the bytes of all processes in the order of their ranks and
    /// returns the result to each process. The function waits until all processes have
    /// called it. If `size` is 1, this function is not called.
    std::function<std::string(const std::string& bytes)> all_gather = {};

    bool is_first() const { return rank == 0; }

    struct PartRange {
        std::size_t begin, end;
    };
    /// Returns the contiguous range of parts, out of `n_parts_of_all_processes`, that
    /// this process computes. The numbers of parts of any two processes differ by at most
    /// one. The first process has at least one part if n_parts_of_all_processes > 0.
    PartRange part_range(std::size_t n_parts_of_all_processes) const {
        const auto first_of = [&](int of) {
            return (n_parts_of_all_processes * std::size_t(of) + std::size_t(size - 1)) / std::size_t(size);
        };
        return {first_of(rank), first_of(rank + 1)};
    }

    /// Collects the values of all processes. Returns all values in the order of the
    /// ranks, in every process.
    template <class T>
    std::vector<T> gather(std::vector<T> local_values) const {
        static_assert(std::is_trivially_copyable_v<T>);
        if (size == 1) return local_values;
        const std::string all =
            all_gather({reinterpret_cast<const char*>(local_values.data()), local_values.size() * sizeof(T)});
        local_values.resize(all.size() / sizeof(T));
        if (!local_values.empty())
            std::memcpy(local_values.data(), all.data(), local_values.size() * sizeof(T));
        return local_values;
    }
    /// Returns the values of the first process in every process. The values of all other
    /// processes are ignored.
    template <class T>
    std::vector<T> broadcast(std::vector<T> values) const {
        if (!is_first()) values.clear();
        return gather(std::move(values));
    }
};

}  // namespace relidar
