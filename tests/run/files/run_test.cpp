// SPDX-License-Identifier: Apache-2.0
#include <relidar/run/run.hpp>

#include <relidar/base/arrays.hpp>

#include <algorithm>
#include <limits>

#include <gmock/gmock.h>
#include <nlohmann/json.hpp>

#include "../../base/codecs/temporary_folder.hpp"
#include "../../support/comma_locale.hpp"
#include "../../support/file_size_limit.hpp"
#include "example_run.hpp"
#include "support/names.hpp"

namespace relidar {
namespace {

using Json = nlohmann::json;

class RunFolder : public TemporaryFolder {
protected:
    void SetUp() override {
        TemporaryFolder::SetUp();
        run = make_example_run(folder / "run");
        save_run(run);
        scene = read_contents(run.folder / "scene.json");
    }
    std::string load_error() {
        return get_data_error_message([&] { load_run(run.folder); });
    }
    std::string get_error_with(const Json& changed) {
        put(run.folder / "scene.json", changed.dump());
        return load_error();
    }
    std::string replaced(const char* pointer, const Json& value) {
        Json changed = Json::parse(scene);
        changed[Json::json_pointer(pointer)] = value;
        return get_error_with(changed);
    }

    relidar::Run run;
    std::string scene;  ///< text of scene.json
};

void expect_equal(const Pose& first, const Pose& second) {
    EXPECT_EQ(first.translation, second.translation);
    EXPECT_EQ(first.rotation, second.rotation);
}

// Tuples of all members. A new member of a struct does not compile until it is added
// here.
auto members(const RayDropNetwork& network) {
    const auto& [image, inputs, widths, heads, taps, residual, normalisation, parameters, running,
                 actor_logits] = network;
    return std::tie(image, inputs, widths, heads, taps, residual, normalisation, parameters, running,
                    actor_logits);
}
auto members(const IntensityScatterModel::DecisionTreeNode& node) {
    const auto& [feature, at, child, first, count] = node;
    return std::tie(feature, at, child, first, count);
}
auto members(const Beam& beam) {
    const auto& [elevation, azimuth, along, up, left, gain, intensity, range] = beam;
    return std::tie(elevation, azimuth, along, up, left, gain, intensity, range);
}
auto members(const Georeference& georeference) {
    const auto& [position, point_m, crs, rotation] = georeference;
    const auto& [latitude, longitude, height] = position;
    return std::tie(latitude, longitude, height, point_m, crs, rotation);
}
template <class T>
void expect_equal(const std::vector<T>& first, const std::vector<T>& second) {
    ASSERT_EQ(first.size(), second.size());
    for (std::size_t i = 0; i < first.size(); ++i) EXPECT_EQ(members(first[i]), members(second[i])) << i;
}

TEST_F(RunFolder, RayDropNetworkIsPartOfIt) {
    EXPECT_TRUE(load_run(run.folder).drop_network.empty());
    const RayDropNetwork network = run.drop_network = make_example_network();
    save_run(run);
    EXPECT_TRUE(members(load_run(run.folder).drop_network) == members(network));
    run.drop_network = {};
    save_run(run);
    EXPECT_TRUE(load_run(run.folder).drop_network.empty()) << "a network of the run before stays";
}

TEST_F(RunFolder, RefusesADamagedRayDropNetwork) {
    run.drop_network = make_example_network();
    save_run(run);
    const auto file = run.folder / "drop_network.safetensors";
    const std::string file_bytes = read_contents(file);
    const auto with_text = [&](const std::string& from, const std::string& to) {
        std::string text = file_bytes;
        text.replace(text.find(from), from.size(), to);
        put(file, text);
        return load_error();
    };
    EXPECT_THAT(with_text("drop network", "lost network"),
                test::Names("drop_network.safetensors ... \"format\" ... \"relidar lost network\""));
    EXPECT_THAT(with_text("heads\\\":2", "heads\\\":3"), test::Names("heads ... 3 ... 8"));
    EXPECT_THAT(with_text("\"running\"", "\"walking\""), test::Names("running"));
    put(file, file_bytes.substr(0, file_bytes.size() - 5));
    EXPECT_THAT(load_error(), test::Names("drop_network.safetensors"));
    run.drop_network.parameters[7] = std::numeric_limits<float>::quiet_NaN();
    save_run(run);
    EXPECT_THAT(load_error(), test::Names("parameters ... entry 7 ... nan"));
}

std::vector<IntensityScatterModel> make_example_scatter() {
    IntensityScatterModel scatter;
    scatter.nodes = {{3, -1.0f / 3.0f, 1, 0, 5}, {-1, 0.0f, 0, 0, 2}, {-1, 0.0f, 0, 2, 3}};
    scatter.values = {0.1f, 0.2f, 0.3f, 0.5f, 0.7f};
    scatter.step = 0.1;
    return {scatter};
}

TEST_F(RunFolder, HowIntensitiesScatterIsPartOfIt) {
    EXPECT_TRUE(load_run(run.folder).intensity_scatter.empty());
    run.intensity_scatter = make_example_scatter();
    save_run(run);
    const std::vector<IntensityScatterModel> read = load_run(run.folder).intensity_scatter;
    ASSERT_EQ(read.size(), run.log.lidars.size());
    const IntensityScatterModel &a = read[0], &b = run.intensity_scatter[0];
    expect_equal(a.nodes, b.nodes);
    EXPECT_EQ(a.values, b.values);
    EXPECT_EQ(a.step, b.step);
    run.intensity_scatter.clear();
    save_run(run);
    EXPECT_TRUE(load_run(run.folder).intensity_scatter.empty()) << "that of the run before stays";
}

TEST_F(RunFolder, RefusesWhatIsNoTree) {
    const auto error_of = [&](const auto& damage) {
        run.intensity_scatter = make_example_scatter();
        damage(run.intensity_scatter[0]);
        save_run(run);
        return load_error();
    };
    const auto is_no_tree = test::Names("intensity_scatter.safetensors ... LiDAR 0");
    EXPECT_THAT(error_of([](IntensityScatterModel& s) { s.nodes[0].child = 2; }), is_no_tree);
    EXPECT_THAT(error_of([](IntensityScatterModel& s) { s.nodes[0].child = 0; }), is_no_tree);
    EXPECT_THAT(error_of([](IntensityScatterModel& s) { s.nodes[0].feature = 10000; }), is_no_tree);
    EXPECT_THAT(error_of([](IntensityScatterModel& s) { s.nodes[2].count = 4; }), is_no_tree);
    EXPECT_THAT(error_of([](IntensityScatterModel& s) { s.nodes[1].count = 0; }), is_no_tree);
    EXPECT_THAT(error_of([](IntensityScatterModel& s) { s.step = -1.0; }),
                test::Names("array 0.step ... -1 ... 0"));
    EXPECT_THAT(
        error_of([](IntensityScatterModel& s) { s.values[1] = std::numeric_limits<float>::infinity(); }),
        test::Names("array 0.values ... finite"));
}

TEST_F(RunFolder, IsTheSameInEveryLocale) {
    const auto files = [&] {
        return read_contents(run.folder / "config.toml") + read_contents(run.folder / "scene.json") +
               read_contents(run.folder / "model.safetensors");
    };
    const std::string before = files();
    const test::CommaLocale comma;
    save_run(load_run(run.folder));
    EXPECT_EQ(files(), before);
}

TEST_F(RunFolder, KeepsWhatWasGuessedAndFoundOfBoxesAndPlaced) {
    EXPECT_FALSE(load_run(run.folder).held_out_placed);
    run.held_out_placed = true;
    BoxTrack& box = run.log.boxes[0];
    box.size_guess = "car";
    box.n_before = 1;
    save_run(run);
    EXPECT_TRUE(load_run(run.folder).held_out_placed);
    const BoxTrack read = load_run(run.folder).log.boxes[0];
    EXPECT_EQ(read.size_guess, "car");
    EXPECT_EQ(read.n_before, 1u);
    EXPECT_EQ(read.n_after, 0u);
}

TEST_F(RunFolder, RoundTripsExactly) {
    const relidar::Run read = load_run(run.folder);
    EXPECT_EQ(to_toml(read.config), to_toml(run.config));
    const Log &a = read.log, &b = run.log;
    EXPECT_EQ(a.name, b.name);
    EXPECT_EQ(a.source, b.source);
    EXPECT_EQ(a.conventions, b.conventions);
    EXPECT_EQ(a.start_unix_ns, b.start_unix_ns);
    EXPECT_EQ(a.labelled_azimuth, b.labelled_azimuth);
    EXPECT_EQ(a.world_offset_m, b.world_offset_m);
    ASSERT_TRUE(a.georeference && b.georeference);
    EXPECT_TRUE(members(*a.georeference) == members(*b.georeference));
    EXPECT_EQ(a.rolling_shutter, b.rolling_shutter);
    ASSERT_EQ(a.cameras.size(), 1u);
    EXPECT_EQ(a.cameras[0].name, "kitti");
    EXPECT_EQ(a.cameras[0].centre_x_px, b.cameras[0].centre_x_px);
    EXPECT_EQ(a.cameras[0].rows, b.cameras[0].rows);
    expect_equal(a.cameras[0].rig_from_camera, b.cameras[0].rig_from_camera);
    ASSERT_EQ(a.frames.size(), b.frames.size());
    for (std::size_t i = 0; i < a.frames.size(); ++i) {
        EXPECT_EQ(a.frames[i].index, b.frames[i].index);
        EXPECT_EQ(a.frames[i].time_s, b.frames[i].time_s);
        EXPECT_EQ(a.world_from_vehicle.time_s[i], b.world_from_vehicle.time_s[i]);
        expect_equal(a.world_from_vehicle.pose[i], b.world_from_vehicle.pose[i]);
        EXPECT_EQ(a.frames[i].azimuth_shift_rad, b.frames[i].azimuth_shift_rad);
    }
    ASSERT_EQ(a.boxes.size(), 2u);
    EXPECT_EQ(a.boxes[0].size_m, b.boxes[0].size_m);
    EXPECT_EQ(a.boxes[0].world_from_box.time_s, b.boxes[0].world_from_box.time_s);
    expect_equal(a.boxes[0].world_from_box.pose[1], b.boxes[0].world_from_box.pose[1]);
    EXPECT_EQ(a.boxes[1].category, "Van");
    EXPECT_EQ(a.boxes[0].size_guess, "");
    EXPECT_EQ(a.boxes[0].n_before + a.boxes[0].n_after, 0u);
    ASSERT_EQ(read.edits.size(), 2u);
    EXPECT_EQ(read.edits[1].run, "/runs/second");
    EXPECT_EQ(read.edits[0].edit, "--move 7:0,3.5,0");
    EXPECT_EQ(read.split.train, run.split.train);
    EXPECT_EQ(read.split.test, run.split.test);
}

TEST_F(RunFolder, SweepsAreThoseOfItsFrames) {
    const std::filesystem::path file = run.folder / "sweeps.safetensors";
    const auto error_with_array = [&](const std::string& name, const std::vector<float>& values) {
        write_safetensors(file, {make_array(name, {values.size()}, values.data(), values.size())},
                          {{"format", "relidar sweeps"}, {"version", "1"}});
        return load_error();
    };
    EXPECT_THAT(error_with_array("000004", std::vector<float>(1030)),
                test::Names("sweeps.safetensors ... \"000004\""));
    EXPECT_THAT(error_with_array("one", std::vector<float>(1030)), test::Names("\"one\" ... frame"));
    EXPECT_THAT(error_with_array("000001", std::vector<float>(16)),
                test::Names("array 000001 ... f4 ... [16] ... f4 ... [1030]"));
    EXPECT_THAT(error_with_array("000001", std::vector<float>(1030, 9.0f)), test::Names("9 ... radians"));
    EXPECT_THAT(error_with_array("000001", std::vector<float>(1030, NAN)), test::Names("nan ... radians"));
    run.log.frames[1].azimuth_shift_rad.clear();
    save_run(run);
    EXPECT_FALSE(std::filesystem::exists(file)) << "no sweep has any";
    EXPECT_TRUE(load_run(run.folder).log.frames[1].azimuth_shift_rad.empty());
}

TEST_F(RunFolder, OwnBodyRoundTripsExactly) {
    const std::filesystem::path file = run.folder / "own_body.safetensors";
    EXPECT_FALSE(std::filesystem::exists(file)) << "nothing carries the LiDAR";
    BodyTable& body = run.log.lidars[0].own_body;
    body = {std::vector<float>(BodyTable::kCells), std::vector<float>(BodyTable::kCells)};
    body.range_m[1000] = 0.4f;
    body.intensity[1000] = BodyTable::kNoReturn;
    save_run(run);
    const BodyTable read = load_run(run.folder).log.lidars[0].own_body;
    EXPECT_EQ(read.range_m, body.range_m);
    EXPECT_EQ(read.intensity, body.intensity);
    const std::vector<float> few(16, 0.5f);
    const NamedArray intensity = make_array("0.intensity", {16}, few.data(), 16);
    write_safetensors(file, {make_array("0.range_m", {16}, few.data(), 16), intensity},
                      {{"format", "relidar own bodies"}, {"version", "1"}});
    EXPECT_THAT(load_error(), test::Names("own_body.safetensors ... 0.range_m ... 259200"));
}

TEST_F(RunFolder, CoverageRoundTripsExactly) {
    const std::filesystem::path file = run.folder / "coverage.safetensors";
    EXPECT_FALSE(std::filesystem::exists(file)) << "nothing is known";
    run.coverage.add_segment({0.5, 0.5, 0.5}, {-70.0, 33.0, 9.0});
    save_run(run);
    const auto expected = run.coverage.list_blocks(),
               loaded_blocks = load_run(run.folder).coverage.list_blocks();
    ASSERT_EQ(loaded_blocks.size(), expected.size());
    for (std::size_t i = 0; i < loaded_blocks.size(); ++i) {
        EXPECT_EQ(loaded_blocks[i].grid_index, expected[i].grid_index);
        EXPECT_EQ(loaded_blocks[i].cells, expected[i].cells);
    }
    const std::vector<std::int32_t> grid_indices(6);
    const std::vector<std::uint16_t> cells(32);
    const auto error_with_arrays = [&](std::size_t width, const std::string& cell_m) {
        write_safetensors(file,
                          {make_array("place", {6 / width, width}, grid_indices.data(), 6),
                           make_array("cells", {1, 32}, cells.data(), 32)},
                          {{"format", "relidar coverage"}, {"version", "1"}, {"cell_m", cell_m}});
        return load_error();
    };
    EXPECT_THAT(error_with_arrays(2, "1"),
                test::Names("coverage.safetensors ... place ... i4 ... [3, 2] ... i4 ... [n, 3]"));
    EXPECT_THAT(error_with_arrays(3, "1"), test::Names("cells ... [1, 32] ... [2, 32]"));
    EXPECT_THAT(error_with_arrays(3, "2"), test::Names("cell_m ... 2 ... 1"));
}

TEST_F(RunFolder, ClassesRoundTripExactly) {
    const std::filesystem::path file = run.folder / "classes.safetensors";
    EXPECT_FALSE(std::filesystem::exists(file)) << "the log has no labelled points";
    run.classes = {{{-700, 3, 12}, SurfaceClass::object}, {{5, -1, 0}, SurfaceClass::unknown}};
    save_run(run);
    EXPECT_EQ(load_run(run.folder).classes, run.classes);
    const std::vector<std::int32_t> grid_indices(6);
    const std::vector<std::uint16_t> classes{1, 17};
    write_safetensors(
        file,
        {make_array("place", {2, 3}, grid_indices.data(), 6), make_array("class", {2, 1}, classes.data(), 2)},
        {{"format", "relidar classes"}, {"version", "1"}, {"cell_m", "0.1"}});
    EXPECT_THAT(load_error(), test::Names("classes.safetensors ... cell 1 ... 17 ... 0 ... 16"));
    run.classes.clear();
    save_run(run);
    EXPECT_FALSE(std::filesystem::exists(file));
}

TEST_F(RunFolder, SensorRoundTripsExactly) {
    const SpinningSensor a = load_run(run.folder).log.lidars[0].sensor, &b = run.log.lidars[0].sensor;
    EXPECT_EQ(a.name, b.name);
    EXPECT_EQ(a.columns, b.columns);
    EXPECT_EQ(a.period_s, b.period_s);
    EXPECT_EQ(a.clockwise, b.clockwise);
    EXPECT_EQ(a.first_azimuth_rad, b.first_azimuth_rad);
    EXPECT_EQ(a.max_range_m, b.max_range_m);
    EXPECT_EQ(a.divergence_rad, b.divergence_rad);
    expect_equal(a.beams, b.beams);
}

TEST_F(RunFolder, TwoLidarsAtOneTimeShareAPose) {
    Log& s = run.log;
    s.lidars.push_back({"rear", s.lidars[0].sensor, make_example_pose(0.3)});
    s.lidars[0].name = "front";
    s.frames.insert(s.frames.begin() + 2, {11, s.frames[1].time_s, {}, 1});
    save_run(run);
    const Log read = load_run(run.folder).log;
    ASSERT_EQ(read.lidars.size(), 2u);
    EXPECT_EQ(read.lidars[1].name, "rear");
    expect_equal(read.lidars[1].vehicle_from_sensor, make_example_pose(0.3));
    ASSERT_EQ(read.frames.size(), 5u);
    EXPECT_EQ(read.frames[2].lidar, 1);
    EXPECT_EQ(read.world_from_vehicle.time_s, s.world_from_vehicle.time_s);
    std::swap(s.frames[1], s.frames[2]);
    EXPECT_THAT(get_data_error_message([&] { save_run(run); }), test::Names("frames[2].time_s"));
}

TEST_F(RunFolder, KeepsWhatMakesTheRaysOfALidarThatDoesNotSpin) {
    Log& s = run.log;
    const WindowScanSensor window{.name = "front",
                                  .rows = 4,
                                  .columns = 6,
                                  .left_rad = 1.0 / 3.0,
                                  .right_rad = -0.3,
                                  .top_rad = 0.1,
                                  .bottom_rad = -0.2,
                                  .period_s = 0.05,
                                  .divergence_rad = 1e-3};
    const RosetteSensor rosette{
        .name = "flower", .deflection_rad = 0.17, .first_hz = 121.57, .second_hz = -77.73, .n_rays = 30};
    RayTable cones = make_rays(rosette, 0.37);
    for (std::size_t i = 0; i < cones.size(); ++i) cones.ray_divergence_rad.push_back(1e-3f / float(i + 1));
    for (const SensorPattern& pattern : {SensorPattern(window), SensorPattern(rosette), SensorPattern(cones),
                                         SensorPattern(make_rays(rosette, 0.37))}) {
        s.lidars[0].sensor = {.name = "fixed", .beams = {}, .columns = 0, .period_s = 0.0};
        s.lidars[0].pattern = pattern;
        s.frames[1].azimuth_shift_rad.clear();
        save_run(run);
        const Lidar read = load_run(run.folder).log.lidars[0];
        ASSERT_TRUE(read.pattern);
        EXPECT_EQ(read.pattern->index(), pattern.index());
        EXPECT_EQ(read.sweep_period_s(), s.lidars[0].sweep_period_s());
        const RayTable a = make_lidar_rays(read, 1.7), b = make_lidar_rays(s.lidars[0], 1.7);
        EXPECT_TRUE(a.direction == b.direction && a.origin == b.origin &&
                    a.time_offset_s == b.time_offset_s && a.channel == b.channel);
        EXPECT_EQ(a.divergence_rad, b.divergence_rad);
        EXPECT_EQ(to_vector(a.ray_divergence_rad), to_vector(b.ray_divergence_rad));
    }
    Json broken = Json::parse(read_contents(run.folder / "scene.json"));
    Json& rays = broken["lidars"][0]["sensor"]["rays"];
    rays["origin"].push_back(1.0);
    EXPECT_THAT(get_error_with(broken), test::Names("lidars[0].sensor.rays ... 91 ... 90"));
    rays["origin"].erase(90);
    rays.erase("divergence_rad");
    rays["divergence"] = std::vector<double>(30, -1e-3);
    EXPECT_THAT(get_error_with(broken), test::Names("entry 0 ... divergence ... -0.001"));
}

TEST_F(RunFolder, TruncatedSceneIsRefused) {
    for (std::size_t keep = 0; keep < scene.size() - 2; keep += 97) {
        put(run.folder / "scene.json", scene.substr(0, keep));
        const std::string message = load_error();
        EXPECT_THAT(message, test::Names("scene.json ... JSON")) << keep << ": " << message;
    }
}

TEST_F(RunFolder, EveryFieldIsNeeded) {
    const Json scene_json = Json::parse(scene);
    // keys for human readers, members with default values, and edits
    const std::vector<std::string> optional_prefixes = {
        "/relidar", "/units",         "/conventions",         "/lidars/0/sensor/spinning/",
        "/edits",   "/start_unix_ns", "/labelled_azimuth_rad"};
    int n_removed_fields = 0;
    const Json flat = scene_json.flatten();
    for (const auto& [pointer, value] : flat.items()) {
        std::string field = pointer;
        while (std::isdigit(static_cast<unsigned char>(field.back())))
            field = field.substr(0, field.find_last_of('/'));
        if (std::any_of(optional_prefixes.begin(), optional_prefixes.end(),
                        [&](const std::string& t) { return field.rfind(t, 0) == 0; }))
            continue;
        Json changed = scene_json;
        const Json::json_pointer at(field);
        changed.at(at.parent_pointer()).erase(at.back());
        const std::string message = get_error_with(changed);
        EXPECT_THAT(message, test::Names("scene.json: ")) << message;
        EXPECT_THAT(message, test::Names(at.back())) << field << ": " << message;
        ++n_removed_fields;
    }
    EXPECT_GT(n_removed_fields, 60);
}

TEST_F(RunFolder, RefusesWrongValues) {
    const std::tuple<const char*, Json, const char*> cases[] = {
        {"/frames/2/time_s", nullptr, "frames[2].time_s ... null"},
        {"/frames/2/time_s", 0.0, "frames[2].time_s ... 0"},
        {"/frames/1/split", "tset", "frames[1].split ... \"tset\""},
        {"/frames/1/world_from_vehicle", {1, 2, 3}, "3 numbers ... 7"},
        {"/frames/1/world_from_vehicle/4", 5.0, "quaternion"},
        {"/frames/1/world_from_vehicle/0", 1e308, "frames[1].world_from_vehicle ... 1e+308 ... 1000000"},
        {"/boxes/0/world_from_box/1/2", -1e7, "boxes[0].world_from_box[1] ... -10000000"},
        {"/world_offset_m/1", 1e308, "world_offset_m ... 1e+308"},
        {"/lidars/0/sensor/spinning/beams/1/range_offset_m", 1e308,
         "lidars[0].sensor.spinning.beams[1].range_offset_m ... 1e+308"},
        {"/lidars/0/sensor/spinning/beams/1/origin_up_m", 1e308,
         "lidars[0].sensor.spinning.beams[1].origin_up_m ... 1e+308"},
        {"/frames", Json::array(), "frames"},
        {"/version", 1, "version: ... 1 ... version 3"},
        {"/format", "other", "format ... \"other\""},
        {"/counts/boxes", 3, "counts.boxes ... 3 ... 2"},
        {"/counts/surfels", 3, "counts.surfels ... 3 ... model.safetensors ... 5"},
        {"/boxes/0/beside_labels", {1, 2}, "boxes[0].beside_labels[1] ... 2"},
        {"/boxes/0/time_s", {1.0}, "boxes[0].world_from_box ... 2 ... 1"},
        {"/lidars/0/sensor/spinning/columns", -1, "lidars[0].sensor.spinning.columns ... -1 ... 1"},
        {"/lidars/0/sensor/spinning/beams/1", {0.0, 1.0}, "lidars[0].sensor.spinning.beams[1] ... object"},
        {"/lidars/0/sensor", {{"name", "x"}}, "lidars[0].sensor ... \"spinning\""},
        {"/boxes/0/size_m/1", 0.0, "boxes[0].size_m ... 4.2 x 0 x 1.5 m ... 0"},
        {"/edits/1", 3, "edits[1] ... 3 ... object"},
        {"/rolling_shutter", 1, "rolling_shutter ... 1"}};
    for (const auto& [pointer, value, names] : cases)
        EXPECT_THAT(replaced(pointer, value), test::Names(names)) << pointer;
    Json many = Json::parse(scene);
    Json& spinning = many["lidars"][0]["sensor"]["spinning"];
    spinning["columns"] = 1000000;
    for (int i = 0; i < 200; ++i) spinning["beams"].insert(spinning["beams"].begin(), spinning["beams"][0]);
    EXPECT_THAT(get_error_with(many), test::Names("1000000 columns ... 16777216"));
    put(run.folder / "scene.json", "[1, 2]");
    EXPECT_THAT(load_error(), test::Names("scene.json ... object"));
    put(run.folder / "scene.json", "{\"format\": 1e999}");
    EXPECT_THAT(load_error(), test::Names("scene.json"));
}

TEST_F(RunFolder, MissingFilesAreNamed) {
    for (const char* name : {"config.toml", "scene.json", "model.safetensors"}) {
        std::filesystem::rename(run.folder / name, folder / name);
        const std::string message = load_error();
        EXPECT_THAT(message, test::Names(std::string(name) + " ... missing"));
        std::filesystem::rename(folder / name, run.folder / name);
    }
    EXPECT_THAT(get_data_error_message([&] { load_run(folder / "nowhere"); }), test::Names("nowhere"));
    EXPECT_TRUE(is_run_folder(run.folder));
    EXPECT_FALSE(is_run_folder(folder));
    EXPECT_FALSE(is_run_folder(folder / "nowhere"));
}

TEST_F(RunFolder, WrongSettingIsDamage) {
    put(run.folder / "config.toml", "[loss]\ndepht = 1\n");
    const std::string message = load_error();
    EXPECT_THAT(message, test::Names("config.toml ... loss.depht: unknown ... loss.depth"));
}

TEST_F(RunFolder, WhatCannotBeReadBackIsNotWritten) {
    run.folder = folder / "second";
    run.log.world_from_vehicle.pose[1].translation.x = std::numeric_limits<double>::quiet_NaN();
    EXPECT_THAT(get_data_error_message([&] { save_run(run); }),
                test::Names("frames[1].world_from_vehicle[0]"));
    EXPECT_FALSE(is_run_folder(run.folder));
    run = make_example_run(folder / "second");
    run.log.world_from_vehicle.pose.pop_back();
    EXPECT_THAT(get_data_error_message([&] { save_run(run); }), test::Names("3 poses ... 4"));
    run = make_example_run(folder / "second");
    // config.toml cannot contain a changed constant of the preset
    run.config.train.mean_rate *= 2.0;
    EXPECT_THAT(get_data_error_message([&] { save_run(run); }), test::Names("preset"));
    EXPECT_FALSE(is_run_folder(run.folder));
}

TEST_F(RunFolder, UnwritableFoldersFailEarly) {
    put(folder / "file", "x");
    std::filesystem::create_symlink(folder / "loop", folder / "loop");
    for (const auto& [path, reason] : {std::pair(folder / "file", "create"),
                                       {folder / "file" / "run", "create"},
                                       {folder / std::string(300, 'x'), "File name too long"},
                                       {folder / "loop" / "run", "Too many levels"},
                                       {"/proc/relidar", "/proc/relidar"}})
        EXPECT_THAT(get_data_error_message([&] { prepare_folder(path); }), test::Names(reason));
    prepare_folder(folder / "a" / "b");
    EXPECT_TRUE(std::filesystem::is_empty(folder / "a" / "b"));
}

TEST_F(RunFolder, IsSavedCompleteOrNotAtAll) {
    const std::string model = read_contents(run.folder / kModelFile);
    relidar::Run grown = run;
    grown.drop_network = make_example_network();
    for (rlim_t n_bytes = 0; n_bytes < 40'000; n_bytes += 5'000) {
        const test::FileSizeLimit full(n_bytes);
        for (const char* name : {"new", "run"}) {
            grown.folder = folder / name;
            try {
                save_run(grown);
                EXPECT_FALSE(load_run(grown.folder).drop_network.empty());
            } catch (const DataError& error) {
                EXPECT_THAT(error.what(), testing::HasSubstr(grown.folder.string() + "/"));
                EXPECT_THAT(error.what(), testing::Not(testing::HasSubstr(".tmp-")));
                EXPECT_FALSE(std::filesystem::exists(folder / "new"));
                EXPECT_EQ(read_contents(run.folder / "scene.json"), scene);
                EXPECT_EQ(read_contents(run.folder / kModelFile), model);
            }
        }
        std::filesystem::remove_all(folder / "new");
    }
    for (const auto& entry : std::filesystem::recursive_directory_iterator(folder))
        EXPECT_EQ(entry.path().string().find(".tmp-"), std::string::npos) << entry.path();
}

TEST_F(RunFolder, GivesItsFilesTheirNamesWhenAllAreWritten) {
    bool was_called = false;
    overwrite_run(run, [&] {
        was_called = true;
        EXPECT_FALSE(std::filesystem::exists(run.folder / "config.toml"))
            << "a process that is killed here leaves what looks like a run";
        EXPECT_TRUE(std::filesystem::exists(run.folder / kModelFile));
    });
    EXPECT_TRUE(was_called);
    EXPECT_EQ(read_contents(load_run(run.folder).folder / "scene.json"), scene);
}

}  // namespace
}  // namespace relidar
