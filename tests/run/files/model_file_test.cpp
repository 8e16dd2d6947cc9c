// SPDX-License-Identifier: Apache-2.0
#include <relidar/run/run.hpp>

#include <algorithm>
#include <limits>

#include <relidar/base/arrays.hpp>

#include "../../base/codecs/temporary_folder.hpp"
#include "example_run.hpp"
#include "support/names.hpp"
#include "support/same_surfels.hpp"

namespace relidar {
namespace {

class ModelFile : public TemporaryFolder {
protected:
    void SetUp() override {
        TemporaryFolder::SetUp();
        path = folder / "model.safetensors";
        scene = wrap_background(make_example_surfels(4));
        scene.models = {{"background", 0, 3}, {"track 7", 3, 1, {2.25f, 0.875f, 0.75f}}};
        scene.instances = {{0, ""}, {1, "7"}};
        save_model(path, scene);
        save_model(folder / "rigid.safetensors", scene);
        arrays = read_safetensors(path, &metadata);
    }
    std::string load_error() {
        return get_data_error_message([&] { load_model(path); });
    }
    /// Writes `arrays` and `metadata`, and returns the error of reading them.
    std::string written_error() {
        write_safetensors(path, arrays, metadata);
        return load_error();
    }
    std::string get_error_with_layout(const std::string& layout) {
        metadata["layout"] = layout;
        return written_error();
    }
    NamedArray& array(const std::string& name) { return *std::ranges::find(arrays, name, &NamedArray::name); }

    std::filesystem::path path;
    Scene scene;
    std::vector<NamedArray> arrays;
    std::map<std::string, std::string> metadata;
};

TEST_F(ModelFile, RoundTripsExactly) {
    const Scene read = load_model(path);
    test::expect_same_surfels(read.surfels, scene.surfels);
    ASSERT_EQ(read.models.size(), 2u);
    EXPECT_EQ(read.models[1].name, "track 7");
    EXPECT_EQ(read.models[1].first, 3u);
    EXPECT_EQ(read.models[1].count, 1u);
    EXPECT_EQ(read.models[0].half_size_m, glm::vec3(0.0f));
    EXPECT_EQ(read.models[1].half_size_m, glm::vec3(2.25f, 0.875f, 0.75f));
    ASSERT_EQ(read.instances.size(), 2u);
    EXPECT_EQ(read.instances[1].model, 1u);
    EXPECT_EQ(read.instances[1].track, "7");
}

TEST_F(ModelFile, KeepsWhichPatchesWereSeen) {
    ObservedBoxSurface surface({4.5, 1.75, 1.5});
    surface.mark_observed({2.25, 0.3, 0.2}, {-1.0, 0.0, 0.0});
    surface.is_completed = true;
    scene.models[1].surface = surface;
    save_model(path, scene);
    const Scene read = load_model(path);
    EXPECT_FALSE(read.models[0].surface);
    ASSERT_TRUE(read.models[1].surface);
    EXPECT_TRUE(read.models[1].surface->is_completed);
    EXPECT_TRUE(read.models[1].surface->is_observed({2.25, 0.3, 0.2}));
    EXPECT_TRUE(read.models[1].surface->is_mirror_observed({2.25, -0.3, 0.2}));
    EXPECT_EQ(read.models[1].surface->covered_sides(), surface.covered_sides());
    arrays = read_safetensors(path, &metadata);
    std::string layout = metadata.at("layout");
    layout.replace(layout.find("\"front\":\"") + 9, 1, "7");
    EXPECT_THAT(get_error_with_layout(layout), test::Names("0 ... 1"));
}

TEST_F(ModelFile, HasTheDocumentedArrays) {
    const std::map<std::string, std::vector<std::size_t>> expected{{"mean", {4, 3}},
                                                                   {"rotation", {4, 4}},
                                                                   {"log_scale", {4, 2}},
                                                                   {"opacity_logit", {4}},
                                                                   {"sh", {4, 3, 16}}};
    ASSERT_EQ(arrays.size(), expected.size());
    for (const NamedArray& a : arrays) {
        EXPECT_EQ(a.shape, expected.at(a.name)) << a.name;
        EXPECT_EQ(a.dtype, "f4");
    }
}

TEST_F(ModelFile, GaussiansHaveASixthArray) {
    convert_surfels(scene.surfels, PrimitiveType::gaussian, 0.3);
    save_model(path, scene);
    arrays = read_safetensors(path, &metadata);
    EXPECT_EQ(array("log_scale_w").shape, std::vector<std::size_t>{4});
    EXPECT_EQ(load_model(path).surfels.log_scale_w, scene.surfels.log_scale_w);
    EXPECT_EQ(metadata.at("primitive"), "gaussian");
    metadata.erase("primitive");
    EXPECT_THAT(written_error(), test::Names("\"primitive\" ... missing"));
    metadata["primitive"] = "gaussian";
    array("log_scale_w").shape = {2, 2};
    EXPECT_THAT(written_error(), test::Names("array log_scale_w"));
    arrays.pop_back();
    EXPECT_THAT(written_error(), test::Names("array log_scale_w ... missing"));
    metadata["primitive"] = "cube";
    EXPECT_THAT(written_error(), test::Names("primitive ... \"cube\""));
}

TEST_F(ModelFile, EveryPrimitiveComesBack) {
    for (const PrimitiveProperties& kind : kPrimitives) {
        convert_surfels(scene.surfels, kind.primitive, 0.3);
        save_model(path, scene);
        EXPECT_EQ(load_model(path).surfels.primitive, kind.primitive) << kind.name;
        EXPECT_EQ(load_model(path).surfels.log_scale_w.size(), kind.third_scale ? 4u : 0u) << kind.name;
        write_safetensors(path, read_safetensors(path, &metadata), metadata);
        EXPECT_EQ(metadata.at("primitive"), kind.name);
        Config config;
        set_value(config, "image.primitive", kind.name);
        EXPECT_EQ(config.image.primitive, kind.primitive);
    }
}

TEST_F(ModelFile, AGaitAndItsStrideComeBack) {
    scene.surfels.add_still_gait();
    scene.surfels.gait[3] = {0.25f, 2.5f, {0.1f, -0.2f, 0.3f}};
    scene.models[1].stride_m = 1.25f;
    save_model(path, scene);
    const Scene read = load_model(path);
    ASSERT_TRUE(read.surfels.bends);
    for (std::size_t i = 0; i < 4; ++i) {
        EXPECT_EQ(read.surfels.gait[i].phase, scene.surfels.gait[i].phase);
        EXPECT_EQ(read.surfels.gait[i].sharpness, scene.surfels.gait[i].sharpness);
        EXPECT_EQ(read.surfels.gait[i].swing, scene.surfels.gait[i].swing);
    }
    EXPECT_EQ(read.models[0].stride_m, 0.0f);
    EXPECT_EQ(read.models[1].stride_m, 1.25f);
    EXPECT_FALSE(load_model(folder / "rigid.safetensors").surfels.bends) << "saved before it had a gait";

    arrays = read_safetensors(path, &metadata);
    NamedArray& gait = array("gait");
    gait.shape = {4, 4};
    gait.bytes.resize(64);
    EXPECT_THAT(written_error(), test::Names("gait"));
}

TEST_F(ModelFile, SensorDropRoundTripsAndIsChecked) {
    EXPECT_TRUE(load_model(path).sensor_drop.empty());
    scene.sensor_drop = {2, 3, {0.0f, 0.25f, 1.0f, 1.0f / 3.0f, 0.5f, 0.75f}};
    save_model(path, scene);
    const RayDropTable read = load_model(path).sensor_drop;
    EXPECT_EQ(read.channels, 2);
    EXPECT_EQ(read.bins, 3);
    EXPECT_EQ(read.probability, scene.sensor_drop.probability);
    const float bad[2] = {0.5f, 1.5f};
    arrays.push_back(make_array("sensor_drop", {1, 2}, bad, 2));
    EXPECT_THAT(written_error(), test::Names("array sensor_drop ... 1.5"));
    arrays.back() = make_array("sensor_drop", {2}, bad, 2);
    EXPECT_THAT(written_error(), test::Names("array sensor_drop ... f4 ... [2] ... [n, n]"));
}

TEST_F(ModelFile, AnEmptySceneRoundTrips) {
    save_model(path, wrap_background({}));
    EXPECT_EQ(load_model(path).surfels.size(), 0u);
}

TEST_F(ModelFile, CutFilesAreRefused) {
    const std::string file_bytes = read_contents(path);
    for (std::size_t keep = 0; keep < file_bytes.size(); keep += keep < 600 ? 37 : 211) {
        put(path, std::string_view(file_bytes).substr(0, keep));
        EXPECT_THAT(load_error(), test::Names("model.safetensors")) << keep;
    }
    std::filesystem::remove(path);
    EXPECT_THAT(load_error(), test::Names("model.safetensors"));
}

TEST_F(ModelFile, ArraysAreChecked) {
    const std::vector<NamedArray> original_arrays = arrays;
    for (const char* name : {"mean", "rotation", "log_scale", "opacity_logit", "sh"}) {
        arrays = original_arrays;
        std::erase_if(arrays, [&](const NamedArray& a) { return a.name == name; });
        EXPECT_THAT(written_error(), test::Names(std::string("array ") + name + " ... missing"));
    }
    arrays = original_arrays;
    array("sh").shape = {4, 48};
    EXPECT_THAT(written_error(), test::Names("sh ... f4 ... [4, 48] ... f4 ... [4, 3, 16]"));
    arrays = original_arrays;
    const float one_row[4] = {1, 0, 0, 0};
    array("rotation") = make_array("rotation", {1, 4}, one_row, 4);
    EXPECT_THAT(written_error(), test::Names("rotation ... [1, 4] ... [4, 4]"));
}

TEST_F(ModelFile, ValuesThatAreNotFiniteAreNamed) {
    const float bad[8] = {0, 0, 0, 0, 0, std::numeric_limits<float>::quiet_NaN(), 0, 0};
    array("log_scale") = make_array("log_scale", {4, 2}, bad, 8);
    EXPECT_THAT(written_error(), test::Names("array log_scale: row 2 ... nan"));
    scene.surfels.sh[1 * kShFloats + 5] = std::numeric_limits<float>::infinity();
    EXPECT_THAT(get_data_error_message([&] { save_model(path, scene); }), test::Names("sh: row 1 ... inf"));
    scene.surfels.rotation.pop_back();
    EXPECT_THROW(save_model(path, scene), DataError);
}

TEST_F(ModelFile, ModelsMustCoverTheSurfels) {
    const std::string models = R"({"models":[{"name":"b","first":)", box = R"(,"half_size_m":[0,0,0]}])";
    const std::string instances = R"(,"instances":[{"model":0,"track":""}]})";
    const auto error = [&](const std::string& text) { return get_error_with_layout(models + text); };
    EXPECT_THAT(error(R"(0,"count":3)" + box + instances), test::Names("3 surfels ... 4"));
    EXPECT_THAT(error(R"(1,"count":3)" + box + instances), test::Names("models[0].first ... 1 ... 0"));
    EXPECT_THAT(error(R"(0,"count":4,"half_size_m":[1,-1,1]}])" + instances),
                test::Names("half_size_m[1] ... -1"));
    EXPECT_THAT(error(R"(0,"count":4}])" + instances), test::Names("models[0].half_size_m ... missing"));
    EXPECT_THAT(error(R"(0,"count":-4)" + box + instances), test::Names("models[0].count ... -4"));
    EXPECT_THAT(error(R"(0,"count":4)" + box + R"(,"instances":[{"model":1,"track":""}]})"),
                test::Names("instances[0].model ... 1"));
    EXPECT_THAT(error(R"(0,"count":4)" + box + R"(,"instances":[]})"), test::Names("instance"));
    EXPECT_THAT(get_error_with_layout("{"), test::Names("layout ... JSON"));
}

TEST_F(ModelFile, OtherFilesAreRefused) {
    write_safetensors(path, arrays, {{"format", "pt"}});
    EXPECT_THAT(load_error(), test::Names("\"format\" ... \"pt\" ... \"relidar model\""));
    metadata["version"] = "9";
    EXPECT_THAT(written_error(), test::Names("version ... \"9\""));
}

}  // namespace
}  // namespace relidar
