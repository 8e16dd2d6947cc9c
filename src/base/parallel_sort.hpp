// SPDX-License-Identifier: Apache-2.0
// Sorts a vector on all threads. This function is separate from parallel.hpp, because the
// headers of oneTBB compile slowly.
#pragma once

#include <vector>

#include <tbb/parallel_sort.h>
#include <tbb/task_arena.h>

namespace relidar {

/// Sorts a vector with oneTBB. The result does not depend on the number of threads if
/// elements that compare as equivalent are equal.
template <class T, class Less>
void parallel_sort(std::vector<T>& values, const Less& less) {
    tbb::this_task_arena::isolate([&] { tbb::parallel_sort(values.begin(), values.end(), less); });
}

}  // namespace relidar
