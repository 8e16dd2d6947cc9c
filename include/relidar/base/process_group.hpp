// SPDX-License-Identifier: Apache-2.0
// Several processes that do one piece of work together, as the ranks of MPI do.
#pragma once

#include <cstddef>
#include <cstring>
#include <functional>
#include <string>
#include <type_traits>
#include <vector>

namespace relidar {

/// Processes that do the same steps in the same order. What takes long in a step is cut
/// into parts that do not depend on how many processes there are; each process does its
/// share of them, and then all have all results. One process by itself does everything.
struct ProcessGroup {
    int rank = 0, size = 1;
    /// Bytes of all processes one after the other, in order of ranks. Returns once all
    /// have come here. Not called where size is 1.
    std::function<std::string(const std::string& own)> all_gather = {};

    bool is_first() const { return rank == 0; }

    struct Share {
        std::size_t begin, end;
    };
    /// What this process does of n parts: neighbours, as many as others do, or one more
    /// or less. The first has some.
    Share share(std::size_t n) const {
        const auto first_of = [&](int of) {
            return (n * std::size_t(of) + std::size_t(size - 1)) / std::size_t(size);
        };
        return {first_of(rank), first_of(rank + 1)};
    }

    /// Values of all processes, in order of ranks.
    template <class T>
    std::vector<T> all_gathered(std::vector<T> own) const {
        static_assert(std::is_trivially_copyable_v<T>);
        if (size == 1) return own;
        const std::string all =
            all_gather({reinterpret_cast<const char*>(own.data()), own.size() * sizeof(T)});
        own.resize(all.size() / sizeof(T));
        if (!own.empty()) std::memcpy(own.data(), all.data(), own.size() * sizeof(T));
        return own;
    }
    /// Values of the first process, in all.
    template <class T>
    std::vector<T> broadcast(std::vector<T> own) const {
        if (!is_first()) own.clear();
        return all_gathered(std::move(own));
    }
};

}  // namespace relidar
