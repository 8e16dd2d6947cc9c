// SPDX-License-Identifier: Apache-2.0
// Commands are processes, not threads or calls: a lost device, a driver that aborts, memory that runs out or a bug ends the process it
// happens in, and must end one job alone. It also leaves nothing behind: each job finds a device and memory as if it were the first.
//
// A job's folder is locked while somebody works in it, and the lock is handed on to the commands: where this process is killed, nobody
// takes the job up before its last command has ended, too.
#include "batch/work.hpp"

#include <chrono>
#include <csignal>
#include <cstring>
#include <map>
#include <memory>
#include <set>
#include <thread>

#include <unistd.h>

#include <fmt/format.h>

#include "batch/output.hpp"
#include "batch/state.hpp"
#include "batch/summary.hpp"
#include "child_process.hpp"
#include "console.hpp"
#include "interrupt.hpp"
#include "output_folder.hpp"
#include <relidar/error.hpp>

namespace relidar::cli {
namespace {

namespace fs = std::filesystem;

constexpr std::chrono::milliseconds kPoll{500};  // at jobs of other processes

std::string host_name() {
    char name[256] = {};
    return ::gethostname(name, sizeof name - 1) == 0 ? name : "unknown";
}

/// First word and place of a command: "render (3 of 4)".
std::string title(const PlannedJob& job, const JobCommand& command) {
    return fmt::format("{} ({} of {})", command.words.front(), &command - job.commands.data() + 1, job.commands.size());
}

/// The one line of a command that failed.
std::string failure(const PlannedJob& job, const JobCommand& command, const ChildEnd& end, std::uintmax_t log_begin) {
    const std::string& name = command.words.front();
    const std::string log = job.log().string();
    if (end.signal != 0)
        return fmt::format("`relidar {}` was ended by signal {} ({}){}; log: {}", name, end.signal, ::strsignal(end.signal),
                           end.signal == SIGKILL ? ", for lack of memory most likely" : "", log);
    const std::string line = error_line(job.log(), log_begin);
    return line.empty() ? fmt::format("`relidar {}` ended with exit code {} and no word of why; log: {}", name, end.exit_code, log) : line;
}

/// Told to stop, by this process or by somebody else: no fault of the job.
bool was_told_to_stop(const ChildEnd& end) {
    return end.exit_code == static_cast<int>(ExitCode::interrupted) || end.signal == SIGTERM || end.signal == SIGINT;
}

class Worker {
public:
    Worker(const BatchPlan& plan, const WorkOptions& options) : plan_(plan), options_(options), progress_(options.quiet) {
        for (std::size_t j = 0; j < plan.jobs.size(); ++j) {
            if (!options.share.has(j)) continue;
            left_.insert(j);
            attempts_before_[j] = load_state(plan.jobs[j].folder).attempts;
        }
        n_jobs_ = left_.size();
    }

    void run() {
        while (!left_.empty() && !interrupted()) {
            std::set<std::size_t> held;
            for (const std::size_t j : left_)
                if (interrupted() || !settle(j)) held.insert(j);
                else ++n_settled_;
            left_ = std::move(held);
            if (left_.empty() || interrupted()) break;
            progress_.show(fmt::format("waiting for {} of {} jobs, which other processes are at", left_.size(), n_jobs_));
            std::this_thread::sleep_for(kPoll);
        }
        end_progress_line();
    }

private:
    /// Whether there is nothing to do for this process. One that failed while this process was there is not tried once more by it.
    bool is_settled(std::size_t j, const JobState& state) const {
        if (state.phase == JobPhase::failed) return !options_.retry_failed || state.attempts != attempts_before_.at(j);
        return plan_.jobs[j].is_done(state.done);
    }

    /// Does a job, where there is something to do. @return false where another process is at it
    bool settle(std::size_t j) {
        const PlannedJob& job = plan_.jobs[j];
        if (is_settled(j, load_state(job.folder))) return true;
        fs::create_directories(job.folder);
        const std::unique_ptr<FolderLock> lock = FolderLock::take_if_free(job.folder);
        if (!lock) return false;
        tell_without_locks(*lock);
        JobState state = load_state(job.folder);   // somebody may have done it before the lock was taken
        if (is_settled(j, state)) return true;
        do_job(job, state, *lock);
        write_summary(plan_);
        return true;
    }

    void do_job(const PlannedJob& job, JobState state, const FolderLock& lock) {
        say("begins", job, state.attempts > 0 ? fmt::format(", time {}", state.attempts + 1) : "");
        ++state.attempts;
        state.host = host_name();
        state.process = ::getpid();
        for (const JobCommand& command : job.commands) {
            if (command.is_in(state.done)) continue;
            if (interrupted()) state.phase = JobPhase::preempted, state.message = "told to stop";
            else do_command(job, command, state, lock);
            if (state.phase != JobPhase::running) break;
        }
        if (state.phase == JobPhase::running) state.phase = JobPhase::done, state.doing.clear();
        save_state(job.folder, state);
        say(phase_name(state.phase), job,
            state.phase == JobPhase::failed ? ": " + state.message : fmt::format(" after {}", duration(state.seconds)));
    }

    void do_command(const PlannedJob& job, const JobCommand& command, JobState& state, const FolderLock& lock) {
        state.phase = JobPhase::running;
        state.doing = command.text;
        state.exit_code = 0;
        state.message.clear();
        save_state(job.folder, state);
        const std::uintmax_t log_begin = begin_log(job.log(), command.words);
        const ChildEnd end = run_child({command.words, job.log(), lock.descriptor()}, [&] {
            const std::string line = last_line(job.log(), log_begin);
            progress_.show(fmt::format("job {} of {}  {}  {}{}", n_settled_ + 1, n_jobs_, job.job.name, title(job, command),
                                       line.empty() ? "" : "  " + line));
        });
        state.seconds += end.seconds;
        state.exit_code = end.exit_code;
        if (end.exit_code == 0) {
            state.done.push_back(command.text);
            state.metrics = mean_metrics(job.run);
            return save_state(job.folder, state);
        }
        state.message = failure(job, command, end, log_begin);
        state.phase = was_told_to_stop(end) ? JobPhase::preempted : JobPhase::failed;
    }

    void say(const std::string& what, const PlannedJob& job, const std::string& more) const {
        if (options_.quiet) return;
        end_progress_line();
        print(fmt::format("{:<9}  {}{}\n", what, job.job.name, more));
        std::fflush(stdout);
    }

    void tell_without_locks(const FolderLock& lock) {
        if (lock.is_exclusive() || told_) return;
        told_ = true;
        note(fmt::format("{}: its file system knows no locks: no two processes may do the same jobs, so give each its --task",
                         plan_.out.string()));
    }

    const BatchPlan& plan_;
    WorkOptions options_;
    Progress progress_;
    std::set<std::size_t> left_;
    std::map<std::size_t, int> attempts_before_;
    std::size_t n_jobs_ = 0, n_settled_ = 0;   ///< of the share
    bool told_ = false;
};

}  // namespace

void work(const BatchPlan& plan, const WorkOptions& options) { Worker(plan, options).run(); }

}  // namespace relidar::cli
