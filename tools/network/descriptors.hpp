// SPDX-License-Identifier: Apache-2.0
// Each connection of a server needs a file descriptor.
#pragma once

#include <sys/resource.h>

namespace relidar {

inline void raise_file_limit() {
    rlimit limit{};
    if (::getrlimit(RLIMIT_NOFILE, &limit) != 0) return;
    limit.rlim_cur = limit.rlim_max;
    (void)::setrlimit(RLIMIT_NOFILE, &limit);  // If raising the limit fails, the lower limit stays.
}

}  // namespace relidar
