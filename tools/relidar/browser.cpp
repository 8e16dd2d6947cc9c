// SPDX-License-Identifier: Apache-2.0
#include "browser.hpp"

#include <fcntl.h>
#include <spawn.h>
#include <unistd.h>

#include <fmt/format.h>

#include "console.hpp"

extern char** environ;

namespace relidar::cli {

void open_in_browser(const std::string& url_or_path) {
    // Uses no shell, because the address may contain special characters.
    std::string program = "xdg-open", argument = url_or_path;
    char* const arguments[] = {program.data(), argument.data(), nullptr};
    // Some browsers print messages, which would mix with the output of this program.
    posix_spawn_file_actions_t quiet;
    posix_spawn_file_actions_init(&quiet);
    for (const int descriptor : {STDIN_FILENO, STDOUT_FILENO, STDERR_FILENO})
        posix_spawn_file_actions_addopen(&quiet, descriptor, "/dev/null", O_RDWR, 0);
    // Does not wait for the process to end, because some browsers stay in the foreground.
    pid_t process = 0;
    const int failed = posix_spawnp(&process, program.c_str(), &quiet, nullptr, arguments, environ);
    posix_spawn_file_actions_destroy(&quiet);
    if (failed != 0)
        print_note(
            fmt::format("cannot start a browser, because the program xdg-open is missing; open {} yourself",
                        url_or_path));
}

}  // namespace relidar::cli
