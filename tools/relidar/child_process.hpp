// SPDX-License-Identifier: Apache-2.0
// This program run again with other arguments, as a process of its own.
#pragma once

#include <filesystem>
#include <functional>
#include <string>
#include <vector>

namespace relidar::cli {

struct ChildCall {
    std::vector<std::string> words;        ///< arguments: "train", "street", "--out", "run"
    std::filesystem::path log;             ///< what it prints is added to this file
    int shared_lock = -1;                  ///< descriptor of a lock that it holds too; -1: none
};

/// How a process ended.
struct ChildEnd {
    int exit_code = 0;   ///< 128 + signal where a signal ended it
    int signal = 0;      ///< 0: none did
    double seconds = 0.0;
};

/// Runs this program and waits for its end. When this process is told to stop (interrupted()), so is the other one, once; where this
/// process dies, however, the system tells it.
/// @param tick called several times a second meanwhile @throws DataError where no process can be started or the log cannot be written
ChildEnd run_child(const ChildCall& call, const std::function<void()>& tick);

}  // namespace relidar::cli
