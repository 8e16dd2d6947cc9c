// SPDX-License-Identifier: Apache-2.0
// Simulates a full disk.
#pragma once

#include <csignal>

#include <sys/resource.h>

namespace relidar::test {

/// Limits the size of files while the object exists. Writes beyond the limit fail as on a
/// full disk.
class FileSizeLimit {
public:
    explicit FileSizeLimit(rlim_t n_bytes) : handler_(std::signal(SIGXFSZ, SIG_IGN)) {
        ::getrlimit(RLIMIT_FSIZE, &before_);
        const rlimit limit{n_bytes, before_.rlim_max};
        ::setrlimit(RLIMIT_FSIZE, &limit);
    }
    ~FileSizeLimit() {
        ::setrlimit(RLIMIT_FSIZE, &before_);
        std::signal(SIGXFSZ, handler_);
    }

private:
    rlimit before_{};
    void (*handler_)(int);
};

}  // namespace relidar::test
