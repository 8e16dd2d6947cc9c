// SPDX-License-Identifier: Apache-2.0
// Sorts a vector on all threads. This header is separate from parallel.hpp because the
// oneTBB headers compile slowly.
#pragma once

#include <vector>

#include <tbb/parallel_sort.h>
#include <tbb/task_arena.h>

namespace relidar {

/// Sorts a vector with oneTBB. The sort is not stable. The result depends on the number
/// of threads only if different elements compare as equivalent.
template <class T, class Less>
void parallel_sort(std::vector<T>& values, const Less& less) {
    tbb::this_task_arena::isolate([&] { tbb::parallel_sort(values.begin(), values.end(), less); });
}

}  // namespace relidar
