// SPDX-License-Identifier: Apache-2.0
// Entry point of the command line program relidar.
#include "program.hpp"

int main(int argc, char** argv) {
    return relidar::cli::run_program(
        {"relidar", "relidar: trains a scene on a LiDAR log and renders new LiDAR scans of it",
         "A first run: `relidar demo`. With your own log:\n"
         "  relidar train LOG --out run && relidar eval run\n"
         "  relidar render run --out scans --frames all\n"
         "Exit codes: 0 done, 1 bug, 2 usage, 3 data, 4 device, 130 interrupted",
         relidar::cli::add_commands},
        argc, argv);
}
