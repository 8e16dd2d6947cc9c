// SPDX-License-Identifier: Apache-2.0
// Separate from parallel.hpp, because the oneTBB headers compile slowly.
#pragma once

#include <vector>

#include <tbb/parallel_sort.h>
#include <tbb/task_arena.h>

namespace relidar {

/// Not stable. If no two elements are equivalent, the result does not depend on the
/// number of threads.
template <class T, class Less>
void parallel_sort(std::vector<T>& values, const Less& less) {
    tbb::this_task_arena::isolate([&] { tbb::parallel_sort(values.begin(), values.end(), less); });
}

}  // namespace relidar
