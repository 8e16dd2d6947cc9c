// SPDX-License-Identifier: Apache-2.0
// Fuzzes small sequences of Boreas, MulRan and ONCE in which the input replaces a file.
#include "harness.hpp"

#include <cstdlib>

#include "changed_files.hpp"
#include "read/scans/stamped_folders.hpp"

namespace relidar::fuzz {
namespace {

namespace fs = std::filesystem;

struct Sequences {
    test::BoreasFolder boreas;
    test::MulranFolder mulran;
    test::OnceFolder once;
    ChangedFiles of_boreas, of_mulran, of_once;

    explicit Sequences(const fs::path& at)
        : boreas((::setenv("TEST_TMPDIR", at.c_str(), 1), "fuzz"), 0, 40),
          mulran("fuzz"),
          once("fuzz", false, 60),
          of_boreas({boreas.poses(), boreas.calibration(), boreas.scan(1)}),
          of_mulran({mulran.poses()}),
          of_once({once.json(), once.scan(1)}) {}
};

const Sequences& make_sequences_in(const fs::path& scratch) {
    static const Sequences sequences(scratch);
    return sequences;
}

std::vector<std::string> make_boreas_seeds(const fs::path& scratch) {
    return make_sequences_in(scratch).of_boreas.make_seeds_of_one();
}
std::vector<std::string> make_mulran_seeds(const fs::path& scratch) {
    return make_sequences_in(scratch).of_mulran.make_seeds_of_one();
}
std::vector<std::string> make_once_seeds(const fs::path& scratch) {
    return make_sequences_in(scratch).of_once.make_seeds_of_one();
}

void read_boreas(std::string_view input, const fs::path& scratch) {
    const Sequences& in = make_sequences_in(scratch);
    in.of_boreas.read_one(input, [&] { load_sequence("boreas:" + in.boreas.folder.string(), {}); });
}

void read_mulran(std::string_view input, const fs::path& scratch) {
    const Sequences& in = make_sequences_in(scratch);
    in.of_mulran.read_one(input, [&] {
        // only two frames, because a scan has 65536 points
        load_sequence("mulran:" + in.mulran.folder.string(), {.frames = {1, 2}});
    });
}

void read_once(std::string_view input, const fs::path& scratch) {
    const Sequences& in = make_sequences_in(scratch);
    in.of_once.read_one(input, [&] { load_sequence("once:" + in.once.folder.string(), {}); });
}

}  // namespace

std::vector<Harness> list_stamped_harnesses() {
    return {{"boreas", make_boreas_seeds, read_boreas},
            {"mulran", make_mulran_seeds, read_mulran},
            {"once", make_once_seeds, read_once}};
}

}  // namespace relidar::fuzz
