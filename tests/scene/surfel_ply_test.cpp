// SPDX-License-Identifier: Apache-2.0
// Tests surfels as PLY: bit-equal values, the layout of 3D Gaussian Splatting, files that
// external tools have edited, and invalid files.
#include <relidar/scene/surfel_ply.hpp>

#include <cmath>
#include <random>
#include <tuple>

#include <fmt/format.h>

#include <relidar/scene/scene.hpp>
#include "base/codecs/temporary_folder.hpp"
#include "support/names.hpp"

namespace relidar {
namespace {

using SurfelPly = TemporaryFolder;

// 3 + 3 + 3 + 45 + 1 + 3 + 4 of 3D Gaussian Splatting, 16 + 16 + 1 of relidar
constexpr std::size_t kProperties = 95;

/// Returns three models with values of all magnitudes and both zeros. A model is empty.
Scene make_some_scene() {
    std::mt19937 random(11);
    std::normal_distribution<float> normal;
    Scene scene;
    scene.surfels.resize(7);
    Surfels& s = scene.surfels;
    for (std::size_t i = 0; i < s.size(); ++i) {
        s.mean[i] = {normal(random), 1e4f * normal(random), 1e-30f * normal(random)};
        s.rotation[i] = {normal(random), normal(random), normal(random), normal(random)};
        s.log_scale[i] = {normal(random), -10.0f};
        s.opacity_logit[i] = normal(random);
    }
    for (float& v : s.sh) v = normal(random);
    s.sh[3] = -0.0f;
    s.sh[20] = std::numeric_limits<float>::denorm_min();
    scene.models = {{"background", 0, 4}, {"empty", 4, 0}, {"7", 4, 3}};
    scene.instances = {{0, ""}, {1, "3"}, {2, "7"}};
    scene.sensor_drop = {1, 2, {0.25f, 0.5f}};
    return scene;
}

template <class V>
void expect_bits(const std::vector<V>& first, const std::vector<V>& second, const char* name) {
    ASSERT_EQ(first.size(), second.size()) << name;
    if (first.empty()) return;
    EXPECT_EQ(std::memcmp(first.data(), second.data(), first.size() * sizeof(V)), 0) << name;
}

void expect_equal(const Scene& first, const Scene& second) {
    expect_bits(first.surfels.mean, second.surfels.mean, "mean");
    expect_bits(first.surfels.rotation, second.surfels.rotation, "rotation");
    expect_bits(first.surfels.log_scale, second.surfels.log_scale, "log_scale");
    expect_bits(first.surfels.opacity_logit, second.surfels.opacity_logit, "opacity_logit");
    expect_bits(first.surfels.sh, second.surfels.sh, "sh");
    expect_bits(first.surfels.log_scale_w, second.surfels.log_scale_w, "log_scale_w");
    ASSERT_EQ(first.models.size(), second.models.size());
    for (std::size_t k = 0; k < first.models.size(); ++k) {
        const SurfelModel &a = first.models[k], &b = second.models[k];
        EXPECT_EQ(std::tuple(a.name, a.first, a.count), std::tuple(b.name, b.first, b.count));
    }
    ASSERT_EQ(first.instances.size(), second.instances.size());
    EXPECT_EQ(first.sensor_drop.probability, second.sensor_drop.probability);
}

/// Reads a file of the scene, without its surfels.
Scene read_edited(const std::filesystem::path& file, const Scene& scene,
                  PrimitiveType primitive = PrimitiveType::surfel) {
    return read_surfel_ply(file, strip_surfels(scene), primitive);
}

/// Header and records of a written file.
struct Parts {
    std::string header;  ///< including its last line
    std::string data;

    explicit Parts(const std::string& file) {
        const std::size_t end = file.find("end_header\n") + 11;
        header = file.substr(0, end);
        data = file.substr(end);
    }
    void replace(const std::string& from, const std::string& to) {
        const std::size_t at = header.find(from);
        ASSERT_NE(at, std::string::npos) << from;
        header.replace(at, from.size(), to);
    }
    float& value(std::size_t row, std::size_t column) {
        return reinterpret_cast<float*>(data.data())[row * kProperties + column];
    }
};

TEST_F(SurfelPly, ComesBackBitEqual) {
    const Scene scene = make_some_scene();
    write_surfels(folder / "a.ply", scene);
    expect_equal(read_edited(folder / "a.ply", scene), scene);
    const Scene empty = wrap_background({});
    write_surfels(folder / "b.ply", empty);
    expect_equal(read_surfel_ply(folder / "b.ply", empty), empty);
    EXPECT_EQ(files().size(), 2u);
}

/// 3D Gaussians must be stored with three scales, as in 3D Gaussian Splatting.
TEST_F(SurfelPly, GaussiansHaveTheirThirdScale) {
    Scene scene = make_some_scene();
    scene.surfels.primitive = PrimitiveType::gaussian;
    for (std::size_t i = 0; i < 7; ++i) scene.surfels.log_scale_w.push_back(-0.1f - float(i) / 7.0f);
    write_surfels(folder / "a.ply", scene);
    expect_equal(read_edited(folder / "a.ply", scene, PrimitiveType::gaussian), scene);
    EXPECT_TRUE(read_edited(folder / "a.ply", scene).surfels.log_scale_w.empty());
    Parts file(read_contents(folder / "a.ply"));
    for (std::size_t i = 0; i < 7; ++i) EXPECT_EQ(file.value(i, 57), scene.surfels.log_scale_w[i]);
    file.replace("property float scale_2\n", "property float thick_2\n");
    put(folder / "b.ply", file.header + file.data);
    const std::string message =
        get_data_error_message([&] { (void)read_edited(folder / "b.ply", scene, PrimitiveType::gaussian); });
    EXPECT_THAT(message, test::Names("property scale_2 ... missing"));
}

TEST_F(SurfelPly, HasTheLayoutOfGaussianSplatting) {
    const Scene scene = make_some_scene();
    write_surfels(folder / "a.ply", scene);
    Parts file(read_contents(folder / "a.ply"));
    std::string expected =
        "ply\nformat binary_little_endian 1.0\ncomment relidar surfels: metres, frame of each model; scale_2 "
        "only makes them flat\nelement vertex 7\n";
    const auto add = [&](const std::string& name) { expected += "property float " + name + "\n"; };
    for (const char* name : {"x", "y", "z", "nx", "ny", "nz", "f_dc_0", "f_dc_1", "f_dc_2"}) add(name);
    for (int k = 0; k < 45; ++k) add(fmt::format("f_rest_{}", k));
    for (const char* name : {"opacity", "scale_0", "scale_1", "scale_2", "rot_0", "rot_1", "rot_2", "rot_3"})
        add(name);
    for (const char* channel : {"hit", "drop"})
        for (int k = 0; k < 16; ++k) add(fmt::format("{}_{}", channel, k));
    add("model");
    EXPECT_EQ(file.header, expected + "end_header\n");
    ASSERT_EQ(file.data.size(), 7 * kProperties * sizeof(float));
    const Surfels& s = scene.surfels;
    for (std::size_t i = 0; i < 7; ++i) {
        for (std::size_t colour = 0; colour < 3; ++colour) {
            EXPECT_EQ(file.value(i, 6 + colour), s.sh[i * kShFloats]);
            for (std::size_t k = 1; k < 16; ++k)
                EXPECT_EQ(file.value(i, 9 + 15 * colour + k - 1), s.sh[i * kShFloats + k]);
        }
        EXPECT_EQ(file.value(i, 54), s.opacity_logit[i]);
        EXPECT_EQ(file.value(i, 55), s.log_scale[i].x);
        EXPECT_NEAR(std::exp(file.value(i, 57)), 1e-4f, 1e-9f);
        for (int k = 0; k < 4; ++k) EXPECT_EQ(file.value(i, 58 + std::size_t(k)), s.rotation[i][k]);
        EXPECT_EQ(file.value(i, 94), i < 4 ? 0.0f : 2.0f);
        const glm::quat q =
            glm::normalize(glm::quat(s.rotation[i][0], s.rotation[i][1], s.rotation[i][2], s.rotation[i][3]));
        const glm::vec3 normal = q * glm::vec3(0.0f, 0.0f, 1.0f);
        for (int axis = 0; axis < 3; ++axis)
            EXPECT_NEAR(file.value(i, 3 + std::size_t(axis)), normal[axis], 1e-6f);
    }
}

/// The tool cropped the scene, changed the order, removed the normals and added
/// properties.
TEST_F(SurfelPly, ReadsWhatAnotherToolEdited) {
    const Scene scene = make_some_scene();
    write_surfels(folder / "a.ply", scene);
    Parts file(read_contents(folder / "a.ply"));
    const std::size_t order[] = {6, 0, 5, 2};
    std::string data;
    for (const std::size_t row : order) {
        data += "\x01\x02";  // an uchar and a char before the floats
        data += file.data.substr(row * kProperties * 4, 3 * 4) +
                file.data.substr((row * kProperties + 6) * 4, (kProperties - 6) * 4);
    }
    file.replace("element vertex 7", "element vertex 4\nproperty uchar flag\nproperty char other");
    for (const char* name : {"nx", "ny", "nz"}) file.replace(fmt::format("property float {}\n", name), "");
    put(folder / "b.ply", file.header + data);
    const Scene read = read_edited(folder / "b.ply", scene);
    Scene expected = strip_surfels(scene);
    expected.surfels = scene.surfels.reorder({0, 2, 6, 5});
    expected.models = {{"background", 0, 2}, {"empty", 2, 0}, {"7", 2, 2}};
    expect_equal(read, expected);
}

/// Names of the properties that editors keep, in the order of such an editor.
std::vector<std::string> list_usual_properties(int n_rest) {
    std::vector<std::string> names{"x",     "y",     "z",     "f_dc_0", "f_dc_1",  "f_dc_2",  "opacity",
                                   "rot_0", "rot_1", "rot_2", "rot_3",  "scale_0", "scale_1", "scale_2"};
    for (int k = 0; k < n_rest; ++k) names.push_back(fmt::format("f_rest_{}", k));
    return names;
}

/// Returns a PLY file with some properties and rows of another file.
std::string select_from_ply(const std::string& file, const std::vector<std::string>& names,
                            const std::vector<std::size_t>& rows) {
    Parts all(file);
    std::vector<std::string> columns;
    for (std::size_t at = 0; (at = all.header.find("property float ", at)) != std::string::npos; ++at)
        columns.push_back(all.header.substr(at + 15, all.header.find('\n', at) - at - 15));
    std::string text = fmt::format("ply\nformat binary_little_endian 1.0\nelement vertex {}\n", rows.size());
    for (const std::string& name : names) text += "property float " + name + "\n";
    text += "end_header\n";
    for (const std::size_t row : rows)
        for (const std::string& name : names) {
            const auto column = std::size_t(std::ranges::find(columns, name) - columns.begin());
            text.append(reinterpret_cast<const char*>(&all.value(row, column)), sizeof(float));
        }
    return text;
}

/// An editor has deleted surfels, changed the order and kept only the usual properties.
TEST_F(SurfelPly, RestoresWhatEditorsDrop) {
    Scene scene = make_some_scene();
    scene.surfels.mean[6] = scene.surfels.mean[2];  // in two models
    write_surfels(folder / "a.ply", scene);
    const std::string all = read_contents(folder / "a.ply");
    for (const int n_rest : {45, 24, 9, 0}) {
        std::string text = select_from_ply(all, list_usual_properties(n_rest), {6, 5, 2, 0});
        if (n_rest == 24 || n_rest == 9) {
            // The editor has dropped the higher degrees of each of the three colours.
            const std::vector<std::string> names = list_usual_properties(n_rest);
            auto* values = reinterpret_cast<float*>(text.data() + text.find("end_header\n") + 11);
            const std::size_t order[] = {6, 5, 2, 0};
            for (std::size_t row = 0; row < 4; ++row)
                for (int k = 0; k < n_rest; ++k)
                    values[row * names.size() + 14 + std::size_t(k)] =
                        scene.surfels.sh[order[row] * kShFloats + std::size_t(k % (n_rest / 3)) + 1];
        }
        put(folder / "b.ply", text);
        std::string note;
        const Scene read = read_surfel_ply(folder / "b.ply", scene, PrimitiveType::surfel, &note);
        Scene expected = strip_surfels(scene);
        expected.surfels = scene.surfels.reorder({2, 0, 6, 5});
        expected.models = {{"background", 0, 2}, {"empty", 2, 0}, {"7", 2, 2}};
        expect_equal(read, expected);
        EXPECT_THAT(note, test::Names("3 of 7"));
    }
    std::string note;
    (void)read_surfel_ply(folder / "a.ply", scene, PrimitiveType::surfel, &note);
    EXPECT_EQ(note, "");
}

/// The file cannot show which of two equal actors an editor has deleted.
TEST_F(SurfelPly, RefusesDeletedSurfelsOfEqualModels) {
    Scene scene = make_some_scene();
    scene.surfels = scene.surfels.reorder({0, 1, 2, 3, 4, 5, 2});  // 2 and 6 are in different models
    write_surfels(folder / "a.ply", scene);
    const std::string all = read_contents(folder / "a.ply");
    put(folder / "b.ply", select_from_ply(all, list_usual_properties(0), {0, 1, 2, 3, 4, 5, 6}));
    EXPECT_EQ(read_surfel_ply(folder / "b.ply", scene).surfels.size(), 7u);
    put(folder / "b.ply", select_from_ply(all, list_usual_properties(0), {0, 1, 2, 3, 4, 5}));
    EXPECT_THROW((void)read_surfel_ply(folder / "b.ply", scene), DataError);
}

TEST_F(SurfelPly, MatchesRoundedPositionsAndKeepsEditedValues) {
    Scene scene = make_some_scene();
    write_surfels(folder / "a.ply", scene);
    std::string text = select_from_ply(read_contents(folder / "a.ply"), list_usual_properties(0), {3});
    auto* values = reinterpret_cast<float*>(text.data() + text.find("end_header\n") + 11);
    values[0] += 1e-5f;
    values[3] = 0.75f;  // f_dc_0
    put(folder / "b.ply", text);
    const Surfels read = read_surfel_ply(folder / "b.ply", scene).surfels;
    ASSERT_EQ(read.size(), 1u);
    EXPECT_EQ(read.mean[0].x, values[0]);
    EXPECT_EQ(read.sh[0], 0.75f);
    for (std::size_t k = 1; k < kShFloats; ++k)
        EXPECT_EQ(read.sh[k], scene.surfels.sh[3 * kShFloats + k]) << k;
    values[1] += 5.0f;
    put(folder / "c.ply", text);
    EXPECT_THAT(get_data_error_message([&] { (void)read_surfel_ply(folder / "c.ply", scene); }),
                test::Names("c.ply ... f_rest_0 ... 1 ... 1 ... vertex 0 ... 5 m"));
}

TEST_F(SurfelPly, ReadsHeadersWithLineEndsOfWindows) {
    const Scene scene = make_some_scene();
    write_surfels(folder / "a.ply", scene);
    const Parts file(read_contents(folder / "a.ply"));
    std::string header;
    for (const char c : file.header) header += c == '\n' ? std::string("\r\n") : std::string(1, c);
    put(folder / "b.ply", header + file.data);
    expect_equal(read_edited(folder / "b.ply", scene), scene);
}

TEST_F(SurfelPly, RefusesFilesThatLie) {
    const Scene scene = make_some_scene(), layout = strip_surfels(scene);
    write_surfels(folder / "a.ply", scene);
    const Parts good(read_contents(folder / "a.ply"));
    const auto refused = [&](const std::string& pattern, const std::function<void(Parts&)>& change) {
        Parts bad = good;
        change(bad);
        put(folder / "bad.ply", bad.header + bad.data);
        const std::string message =
            get_data_error_message([&] { (void)read_surfel_ply(folder / "bad.ply", layout); });
        EXPECT_NE(message.find("bad.ply"), std::string::npos) << message;
        EXPECT_THAT(message, test::Names(pattern));
    };
    refused("ascii", [](Parts& p) { p.replace("binary_little_endian", "ascii"); });
    refused("begin ... \"ply\"", [](Parts& p) { p.header[0] = 'x'; });
    refused("end_header ... missing", [](Parts& p) { p.replace("end_header\n", "end_hea"); });
    refused("drop_3 ... missing", [](Parts& p) { p.replace("drop_3\n", "dropped_3\n"); });
    refused("property x", [](Parts& p) { p.replace("float x\n", "float q\n"); });
    refused("f_rest_4 ... type", [](Parts& p) { p.replace("float f_rest_4\n", "double f_rest_4\n"); });
    refused("property y ... twice", [](Parts& p) { p.replace("float z\n", "float y\n"); });
    refused("type \"list\"", [](Parts& p) { p.replace("float nx\n", "list uchar int nx\n"); });
    refused("element face", [](Parts& p) { p.replace("end_header", "element face 3\nend_header"); });
    refused("before",
            [](Parts& p) { p.replace("element vertex 7\n", "property float e\nelement vertex 7\n"); });
    refused("element vertex", [](Parts& p) { p.replace("format binary_little_endian 1.0\n", ""); });
    for (const char* count : {"6", "8", "0", "4294967295"})
        refused("expected " + std::string(count) + " vertices",
                [&](Parts& p) { p.replace("vertex 7", fmt::format("vertex {}", count)); });
    for (const char* count : {"99999999999999999999", "4294967296", "-1", "7x", ""})
        refused("count", [&](Parts& p) { p.replace("vertex 7", fmt::format("vertex {}", count)); });
    refused("7 vertices", [](Parts& p) { p.data += "x"; });
    refused("vertex 5: opacity ... nan", [](Parts& p) { p.value(5, 54) = std::nanf(""); });
    refused("vertex 2: scale_1 ... inf",
            [](Parts& p) { p.value(2, 56) = std::numeric_limits<float>::infinity(); });
    for (const float model : {3.0f, -1.0f, 0.5f, 1e30f})
        refused("vertex 1 ... model", [&](Parts& p) { p.value(1, 94) = model; });
    EXPECT_THROW((void)read_surfel_ply(folder / "nothing.ply", layout), DataError);
}

TEST_F(SurfelPly, SurfelsInTheWorldAreNotReadBackAsAScene) {
    const Scene scene = make_some_scene();
    write_surfels(folder / "a.ply", scene.surfels,
                  {{"time_s", "1.5"}, {"add_to_positions_m", "1 2 3\nelement vertex 9"}});
    const std::string bytes = read_contents(folder / "a.ply");
    EXPECT_NE(bytes.find(": metres, world"), std::string::npos);
    EXPECT_THAT(
        bytes,
        testing::HasSubstr(
            "\ncomment time_s 1.5\ncomment add_to_positions_m 1 2 3 element vertex 9\nelement vertex 7\n"));
    EXPECT_THROW((void)read_surfel_ply(folder / "a.ply", scene), DataError);
}

TEST_F(SurfelPly, RefusesEveryTruncation) {
    const Scene scene = make_some_scene();
    write_surfels(folder / "a.ply", scene);
    const std::string good = read_contents(folder / "a.ply");
    for (std::size_t size = 0; size < good.size(); size += 13) {
        put(folder / "cut.ply", good.substr(0, size));
        get_data_error_message([&] { (void)read_surfel_ply(folder / "cut.ply", scene); });
    }
}

TEST_F(SurfelPly, WritesOnlyWholeScenes) {
    Scene gap = make_some_scene(), ragged = make_some_scene();
    gap.models[2].first = 5;
    ragged.surfels.sh.pop_back();
    get_data_error_message([&] { write_surfels(folder / "a.ply", gap); });
    get_data_error_message([&] { write_surfels(folder / "a.ply", ragged); });
    EXPECT_TRUE(files().empty());
}

}  // namespace
}  // namespace relidar
