// SPDX-License-Identifier: Apache-2.0
// Tests the state in a checkpoint, and checkpoint files. If one is damaged, the previous
// checkpoint must be used. Python must read the files according to the documented format.
#include <cstdlib>

#include <bit>
#include <limits>
#include <random>

#include <relidar/run/checkpoint.hpp>

#include "../../base/codecs/temporary_folder.hpp"
#include "../../support/device.hpp"
#include "../../support/file_size_limit.hpp"
#include "../files/example_run.hpp"
#include "support/names.hpp"
#include "support/same_surfels.hpp"

namespace relidar {
namespace {

namespace fs = std::filesystem;
using CheckpointFile = TemporaryFolder;

Checkpoint example(int iteration) {
    Checkpoint checkpoint{iteration, {{"setting/loss.depth", "0.1"}, {"layout", "{\"models\":[]}"}}, {}};
    CheckpointWriter write(checkpoint);
    write("steps", std::vector<std::uint64_t>{1, 2, 0xFFFFFFFFFFFFFFFFull});
    write("values", std::vector<float>{0.1f, -0.0f, 1e-40f, 3e38f});
    write("extent", 1.0 / 3.0);
    write("nothing", std::vector<double>{});
    return checkpoint;
}

void expect_equal(const Checkpoint& first, const Checkpoint& second) {
    EXPECT_EQ(first.iteration, second.iteration);
    EXPECT_EQ(first.texts, second.texts);
    ASSERT_EQ(first.arrays.size(), second.arrays.size());
    for (std::size_t i = 0; i < first.arrays.size(); ++i) {
        EXPECT_EQ(first.arrays[i].name, second.arrays[i].name);
        EXPECT_EQ(first.arrays[i].dtype, second.arrays[i].dtype);
        EXPECT_EQ(first.arrays[i].shape, second.arrays[i].shape);
        EXPECT_TRUE(first.arrays[i].bytes == second.arrays[i].bytes) << first.arrays[i].name;
    }
}

struct Loaded {
    std::optional<Checkpoint> checkpoint;
    std::vector<std::string> notes;
};
Loaded load(const fs::path& folder) {
    Loaded loaded;
    loaded.checkpoint = load_newest(folder, [&](const std::string& note) { loaded.notes.push_back(note); });
    return loaded;
}

TEST_F(CheckpointFile, ComesBackBitByBit) {
    write_checkpoint(folder / "a", example(400));
    expect_equal(read_checkpoint(folder / "a"), example(400));
}

TEST_F(CheckpointFile, PythonReadsItAndGetsTheSameChecksum) {
    if (std::system("python3 -c 'import json, struct, zlib' 2>/dev/null") != 0) GTEST_SKIP() << "no python3";
    write_checkpoint(folder / "a", example(400));
    put(folder / "read.py", R"(
import json, struct, sys, zlib
file = open(sys.argv[1], 'rb').read()
size = struct.unpack('<Q', file[:8])[0]
header, data = json.loads(file[8:8 + size]), file[8 + size:]
meta = header.pop('__metadata__')
types = {'F32': ('f4', 'f'), 'F64': ('f8', 'd'), 'U64': ('u8', 'Q')}
crc = 0
for key in sorted(meta):
    if key != 'crc32': crc = zlib.crc32(key.encode() + b'\0' + meta[key].encode() + b'\0', crc)
values = {}
for name, a in sorted(header.items(), key=lambda item: (item[1]['data_offsets'], list(header).index(item[0]))):
    bytes_of = data[a['data_offsets'][0]:a['data_offsets'][1]]
    numpy, code = types[a['dtype']]
    crc = zlib.crc32(f"{name}\0{numpy}\0{','.join(map(str, a['shape']))}\0".encode() + bytes_of, crc)
    values[name] = struct.unpack('<%d%s' % (len(bytes_of) // struct.calcsize(code), code), bytes_of)
assert meta['format'] == 'relidar checkpoint' and meta['version'] == '1' and meta['iteration'] == '400', meta
assert meta['setting/loss.depth'] == '0.1', meta
assert values['steps'] == (1, 2, 2**64 - 1) and values['extent'] == (1 / 3,) and values['nothing'] == (), values
assert '%08x' % crc == meta['crc32'], (hex(crc), meta['crc32'])
)");
    EXPECT_EQ(
        std::system(
            ("python3 '" + (folder / "read.py").string() + "' '" + (folder / "a").string() + "'").c_str()),
        0);
}

TEST_F(CheckpointFile, CutAnywhereItIsRefusedAndTheOneBeforeIsTaken) {
    save_checkpoint(folder, example(100), 2);
    save_checkpoint(folder, example(200), 2);
    const fs::path newest = list_checkpoints(folder).back();
    const std::string file_bytes = read_contents(newest);
    constexpr std::size_t kCuts = 200;
    for (std::size_t i = 0; i < kCuts; ++i) {
        const std::size_t length = i * file_bytes.size() / kCuts;
        SCOPED_TRACE(length);
        put(newest, file_bytes.substr(0, length));
        const std::string message = get_data_error_message([&] { read_checkpoint(newest); });
        EXPECT_THAT(message, test::Names(newest.string())) << message;
        const Loaded loaded = load(folder);
        ASSERT_TRUE(loaded.checkpoint);
        EXPECT_EQ(loaded.checkpoint->iteration, 100);
        EXPECT_EQ(loaded.notes.size(), 1u);
    }
    put(newest, file_bytes.substr(0, file_bytes.size() - 1));  // without the last byte
    EXPECT_EQ(load(folder).checkpoint->iteration, 100);
}

TEST_F(CheckpointFile, EveryFlippedBitIsNoticed) {
    write_checkpoint(folder / "a", example(400));
    const std::string file_bytes = read_contents(folder / "a");
    std::mt19937 random(7);
    for (int i = 0; i < 2000; ++i) {
        const std::size_t bit = random() % (8 * file_bytes.size());
        SCOPED_TRACE(bit);
        std::string flipped = file_bytes;
        flipped[bit / 8] = static_cast<char>(flipped[bit / 8] ^ (1 << bit % 8));
        put(folder / "a", flipped);
        try {
            // The flipped byte may at most be a blank in the padding of the header, which
            // does not change the content.
            expect_equal(read_checkpoint(folder / "a"), example(400));
        } catch (const DataError&) {}
    }
}

TEST_F(CheckpointFile, OtherVersionsAndFormatsAreRefused) {
    const auto message = [&](const std::string& key, const std::string& value) {
        write_checkpoint(folder / "a", example(400));
        std::map<std::string, std::string> texts;
        const std::vector<NamedArray> arrays = read_safetensors(folder / "a", &texts);
        if (value.empty()) texts.erase(key);
        else texts[key] = value;
        write_safetensors(folder / "a", arrays, texts);
        return get_data_error_message([&] { read_checkpoint(folder / "a"); });
    };
    EXPECT_THAT(message("version", "2"), test::Names("version ... \"2\" ... \"1\""));
    EXPECT_THAT(message("format", "relidar model"), test::Names("\"relidar checkpoint\""));
    EXPECT_THAT(message("crc32", ""), test::Names("\"crc32\" ... missing"));
    EXPECT_THAT(message("setting/loss.depth", "0.2"), test::Names("checksum"));
    EXPECT_THAT(message("iteration", ""), test::Names("checksum"));
}

TEST_F(CheckpointFile, NumbersThatAreNotFiniteAreRefused) {
    for (const float bad :
         {std::numeric_limits<float>::quiet_NaN(), std::numeric_limits<float>::infinity()}) {
        Checkpoint checkpoint = example(400);
        CheckpointWriter write(checkpoint);
        write("moments", std::vector<float>{1.0f, 2.0f, bad});
        const std::string before = get_data_error_message([&] { check_finite_arrays(checkpoint); });
        EXPECT_THAT(before, test::Names("row 2 ... array \"moments\"")) << before;
        write_checkpoint(folder / "a", checkpoint);
        EXPECT_THAT(get_data_error_message([&] { read_checkpoint(folder / "a"); }),
                    test::Names("row 2 ... array \"moments\""));
    }
}

TEST_F(CheckpointFile, KeepsTheNewestAndLeavesNoFuture) {
    for (const int iteration : {10, 20, 30, 40}) save_checkpoint(folder / "c", example(iteration), 2);
    put(folder / "c" / "notes.txt", "somebody's");
    ASSERT_EQ(list_checkpoints(folder / "c").size(), 2u);
    EXPECT_EQ(load(folder / "c").checkpoint->iteration, 40);
    put(list_checkpoints(folder / "c").back(), "damaged");  // training resumes from 30 ...
    EXPECT_EQ(load(folder / "c").checkpoint->iteration, 30);
    save_checkpoint(folder / "c", example(35), 2);
    EXPECT_EQ(list_checkpoints(folder / "c").size(), 2u);
    EXPECT_EQ(load(folder / "c").checkpoint->iteration, 35);
    EXPECT_TRUE(load(folder / "c").notes.empty());
    // more digits than the padding of the file name
    save_checkpoint(folder / "c", example(100'000'000), 1);
    EXPECT_EQ(list_checkpoints(folder / "c").size(), 1u);
    EXPECT_EQ(load(folder / "c").checkpoint->iteration, 100'000'000);
    remove_checkpoints(folder / "c");
    EXPECT_TRUE(fs::exists(folder / "c" / "notes.txt"));
    EXPECT_TRUE(list_checkpoints(folder / "c").empty());
}

TEST_F(CheckpointFile, NoneIsNothingAndOnlyDamagedOnesAreAnError) {
    EXPECT_FALSE(load(folder / "nowhere").checkpoint);
    EXPECT_FALSE(load(folder).checkpoint);
    save_checkpoint(folder, example(10), 2);
    put(list_checkpoints(folder).back(), "damaged");
    EXPECT_THAT(get_data_error_message([&] { load(folder); }), test::Names("1 checkpoints"));
}

TEST_F(CheckpointFile, AFullDiskLosesNothing) {
    save_checkpoint(folder, example(10), 1);
    {
        const test::FileSizeLimit limit(256);
        EXPECT_THAT(get_data_error_message([&] { save_checkpoint(folder, example(20), 1); }),
                    test::Names("File too large"));
    }
    EXPECT_EQ(files().size(), 1u);
    EXPECT_EQ(load(folder).checkpoint->iteration, 10);
    save_checkpoint(folder, example(30), 1);
    EXPECT_EQ(load(folder).checkpoint->iteration, 30);
}

class DeviceState : public test::DeviceTest {};

TEST(State, NumbersAndVectorsComeBack) {
    Checkpoint checkpoint;
    CheckpointWriter write(checkpoint);
    const std::uint64_t state = 0x0123456789ABCDEFull;
    write("state", state);
    write("order", std::vector<std::uint64_t>{2, 0, 1});
    write("extent", 0.1);
    write("empty", std::vector<float>{});
    const CheckpointReader read(checkpoint);
    std::uint64_t state_back = 0;
    double extent = 0.0;
    std::vector<std::uint64_t> order;
    std::vector<float> empty(3);
    read("state", state_back);
    read("extent", extent);
    read("order", order);
    read("empty", empty);
    EXPECT_EQ(state_back, state);
    EXPECT_EQ(std::bit_cast<std::uint64_t>(extent), std::bit_cast<std::uint64_t>(0.1));
    EXPECT_EQ(order, (std::vector<std::uint64_t>{2, 0, 1}));
    EXPECT_TRUE(empty.empty());
}

TEST(State, WhatDoesNotFitIsNamed) {
    Checkpoint checkpoint{7, {}, {}};
    CheckpointWriter write(checkpoint);
    write("x", std::vector<float>{1.0f, 2.0f});
    const CheckpointReader read(checkpoint);
    double number = 0.0;
    std::vector<double> wrong_type;
    EXPECT_THAT(get_data_error_message([&] { read("y", number); }),
                test::Names("iteration 7 ... array \"y\""));
    EXPECT_THAT(get_data_error_message([&] { read("x", number); }),
                test::Names("array x ... f4 ... [2] ... f8 ... []"));
    EXPECT_THAT(get_data_error_message([&] { read("x", wrong_type); }),
                test::Names("array x ... f4 ... [2] ... f8 ... [2]"));
    EXPECT_THAT(get_data_error_message([&] { checkpoint.text("layout"); }), test::Names("key \"layout\""));
}

TEST_F(DeviceState, SurfelsAndArraysComeBack) {
    constexpr std::uint32_t n = 5;
    const Surfels surfels = make_example_surfels(n);
    SurfelArrays arrays(device(), n, "state"), back(device(), n, "state read back"),
        smaller(device(), n - 1, "too small");
    arrays.upload(surfels);
    Array<float> statistics(device(), std::vector<float>{3.0f, 1.0f, 4.0f}, "statistics"),
        statistics_back(device(), 3, "statistics read back");
    Checkpoint checkpoint;
    CheckpointWriter write(checkpoint);
    write("parameters", arrays);
    write("statistics", statistics);
    EXPECT_EQ(checkpoint.array("parameters/sh").shape, (std::vector<std::size_t>{n, 3, 16}));
    const CheckpointReader read(checkpoint);
    read("parameters", back);
    read("statistics", statistics_back);
    const Surfels b = back.download(), host = read.read_surfels("parameters");
    for (const Surfels* s : {&b, &host}) test::expect_same_surfels(*s, surfels);
    EXPECT_EQ(statistics_back.download(), statistics.download());
    EXPECT_THAT(get_data_error_message([&] { read("parameters", smaller); }),
                test::Names("array parameters/mean ... f4 ... [5, 3] ... f4 ... [4, 3]"));
    std::erase_if(checkpoint.arrays, [](const NamedArray& a) { return a.name == "parameters/rotation"; });
    EXPECT_THAT(get_data_error_message([&] { read.read_surfels("parameters"); }),
                test::Names("array \"parameters/rotation\""));
}

TEST_F(DeviceState, GaussiansComeBackAndNothingElseInTheirPlace) {
    constexpr std::uint32_t n = 5;
    Surfels gaussians = make_example_surfels(n);
    convert_surfels(gaussians, PrimitiveType::gaussian, 0.3);
    SurfelArrays arrays(device(), n, "state", PrimitiveType::gaussian),
        back(device(), n, "state read back", PrimitiveType::gaussian), of_surfels(device(), n, "surfels");
    arrays.upload(gaussians);
    Checkpoint checkpoint;
    CheckpointWriter{checkpoint}("parameters", arrays);
    const CheckpointReader read(checkpoint);
    read("parameters", back);
    EXPECT_EQ(back.download().log_scale_w, gaussians.log_scale_w);
    EXPECT_EQ(read.read_surfels("parameters").log_scale_w, gaussians.log_scale_w);
    get_data_error_message([&] { read("parameters", of_surfels); });
    EXPECT_EQ(checkpoint.text("parameters/primitive"), "gaussian");
    checkpoint.texts.clear();
    EXPECT_THAT(get_data_error_message([&] { read.read_surfels("parameters"); }),
                test::Names("\"parameters/primitive\""));
    checkpoint.arrays.pop_back();
    checkpoint.texts["parameters/primitive"] = "gaussian";
    EXPECT_THAT(get_data_error_message([&] { read.read_surfels("parameters"); }),
                test::Names("array \"parameters/log_scale_w\""));
    checkpoint.texts["parameters/primitive"] = "cube";
    EXPECT_THAT(get_data_error_message([&] { read.read_surfels("parameters"); }), test::Names("\"cube\""));
}

}  // namespace

}  // namespace relidar
