// SPDX-License-Identifier: Apache-2.0
// File descriptors of a server. Each connection needs one.
#pragma once

#include <sys/resource.h>

namespace relidar {

/// Raises the limit of open descriptors to the maximum that the system allows.
inline void raise_descriptor_limit() {
    rlimit limit{};
    if (::getrlimit(RLIMIT_NOFILE, &limit) != 0) return;
    limit.rlim_cur = limit.rlim_max;
    (void)::setrlimit(RLIMIT_NOFILE, &limit);  // On failure the lower limit stays.
}

}  // namespace relidar
