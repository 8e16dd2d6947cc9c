// SPDX-License-Identifier: Apache-2.0
// Descriptors of a server: each connection needs one.
#pragma once

#include <sys/resource.h>

namespace relidar {

/// Lets the process open as many descriptors as the system allows it.
inline void raise_descriptor_limit() {
    rlimit limit{};
    if (::getrlimit(RLIMIT_NOFILE, &limit) != 0) return;
    limit.rlim_cur = limit.rlim_max;
    (void)::setrlimit(RLIMIT_NOFILE, &limit);  // otherwise the lower limit stays
}

}  // namespace relidar
