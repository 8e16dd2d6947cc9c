// SPDX-License-Identifier: Apache-2.0
#include "program.hpp"

namespace relidar::cli {
namespace {

void add_commands(CLI::App& app, ParsedCommand& call) {
    for (const auto& add : {add_demo, add_train, add_refine, add_render, add_view, add_serve, add_edit,
                            add_assets, add_eval, add_export, add_convert, add_info, add_list, add_check})
        add(app, call);
}

}  // namespace
}  // namespace relidar::cli

int main(int argc, char** argv) {
    return relidar::cli::run_program(
        {"relidar", "relidar: trains a scene on a LiDAR log and renders new LiDAR scans of it",
         "A first run: `relidar demo`. With your own log:\n"
         "  relidar train LOG --out run && relidar eval run\n"
         "  relidar render run --out scans --frames all\n"
         "Exit codes: 0 success, 1 bug in relidar, 2 wrong usage, 3 invalid data, 4 device\n"
         "error, 130 interrupted",
         relidar::cli::add_commands},
        argc, argv);
}
