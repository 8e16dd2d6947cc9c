// SPDX-License-Identifier: Apache-2.0
#include "program.hpp"

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
