// SPDX-License-Identifier: Apache-2.0
// Linux: /proc/self/exe is the program that runs, even where its file has been replaced meanwhile, so that all jobs of a batch are done by
// one build.
#include "child_process.hpp"

#include <cerrno>
#include <chrono>
#include <csignal>
#include <system_error>
#include <thread>

#include <fcntl.h>
#include <sys/prctl.h>
#include <sys/wait.h>
#include <unistd.h>

#include <fmt/format.h>

#include "interrupt.hpp"
#include <relidar/error.hpp>

namespace relidar::cli {
namespace {

constexpr const char* kThisProgram = "/proc/self/exe";
constexpr std::chrono::milliseconds kTick{100};
constexpr int kNotStarted = 127;   // as shells have it

std::string system_message() { return std::generic_category().message(errno); }

/// Between fork and exec: system calls alone.
[[noreturn]] void become(const ChildCall& call, std::vector<char*>& arguments, int log, pid_t parent) {
    ::prctl(PR_SET_PDEATHSIG, SIGTERM);   // nobody waits for the result of an orphan: it saves what it has and ends
    if (::getppid() != parent) ::_exit(kNotStarted);   // died before the line above
    const int nothing = ::open("/dev/null", O_RDONLY);
    ::dup2(nothing, STDIN_FILENO);
    ::dup2(log, STDOUT_FILENO);
    ::dup2(log, STDERR_FILENO);
    if (call.shared_lock >= 0) ::fcntl(call.shared_lock, F_SETFD, 0);   // stays open
    ::execv(kThisProgram, arguments.data());
    ::_exit(kNotStarted);
}

pid_t start(const ChildCall& call) {
    const int log = ::open(call.log.c_str(), O_WRONLY | O_CREAT | O_APPEND | O_CLOEXEC, 0666);
    if (log < 0) throw DataError(fmt::format("{}: cannot be written: {}", call.log.string(), system_message()));
    std::vector<std::string> words{"relidar"};
    words.insert(words.end(), call.words.begin(), call.words.end());
    std::vector<char*> arguments;
    for (std::string& word : words) arguments.push_back(word.data());
    arguments.push_back(nullptr);
    const pid_t parent = ::getpid();
    const pid_t child = ::fork();
    if (child == 0) become(call, arguments, log, parent);
    const std::string why = child < 0 ? system_message() : "";
    ::close(log);
    if (child < 0) throw DataError(fmt::format("starting `relidar {}`: {}", call.words.front(), why));
    return child;
}

}  // namespace

ChildEnd run_child(const ChildCall& call, const std::function<void()>& tick) {
    const auto begin = std::chrono::steady_clock::now();
    const pid_t child = start(call);
    int status = 0;
    bool told = false;
    for (pid_t ended = 0; ended == 0;) {
        ended = ::waitpid(child, &status, WNOHANG);
        if (ended < 0) throw Error(ExitCode::bug, fmt::format("waiting for `relidar {}`: {}", call.words.front(), system_message()));
        if (ended != 0) break;
        if (interrupted() && !told) told = ::kill(child, SIGTERM) == 0;
        tick();
        std::this_thread::sleep_for(kTick);
    }
    const double seconds = std::chrono::duration<double>(std::chrono::steady_clock::now() - begin).count();
    if (WIFSIGNALED(status)) return {128 + WTERMSIG(status), WTERMSIG(status), seconds};
    return {WEXITSTATUS(status), 0, seconds};
}

}  // namespace relidar::cli
