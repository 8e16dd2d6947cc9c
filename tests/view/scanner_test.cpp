// SPDX-License-Identifier: Apache-2.0
// Compares live scans of the viewer with the library's renderer, including edits.
#include "../../tools/view/scanner.hpp"

#include <cstring>
#include <memory>

#include <gmock/gmock.h>
#include <nlohmann/json.hpp>

#include <relidar/base/error.hpp>
#include <relidar/read/dataset.hpp>
#include <relidar/run/edit.hpp>
#include <relidar/simulate/place_points.hpp>
#include "../support/device.hpp"
#include "../support/drop_networks.hpp"

namespace relidar::view {
namespace {

using Json = nlohmann::json;

Run make_small_run() {
    Run run;
    run.folder = "nowhere";
    run.config = make_preset("quick");
    run.config.dataset.path = "synthetic:nowhere";
    run.config.refine.enabled = false;
    StreetOptions street;
    street.n_frames = 6;
    street.rows = 16;
    street.columns = 256;
    run.log = make_street_log(street);
    run.split = split_frames(run.log, 3);
    InitOptions options;
    options.actor_min_points = 10;
    run.scene = init_scene(run.log, run.split.train, options);
    run.coverage = observe_coverage(run.log, run.log.world_from_vehicle, run.split.train, 80.0);
    for (Frame& frame : run.log.frames) frame.scan = {};  // as in a loaded run
    return run;
}

struct Read {
    Json header;
    std::string arrays;

    explicit Read(const std::string& bytes) {
        std::uint32_t length = 0;
        std::memcpy(&length, bytes.data() + 4, 4);
        EXPECT_EQ(bytes.substr(0, 4), "RLV1");
        EXPECT_EQ(length % 4, 0u);
        header = Json::parse(bytes.substr(8, length));
        arrays = bytes.substr(8 + length);
    }
    template <class T>
    std::vector<T> array(const std::string& name) const {
        for (const Json& entry : header["arrays"])
            if (entry["name"] == name) {
                std::vector<T> values(entry["count"].get<std::size_t>());
                std::memcpy(values.data(), arrays.data() + entry["offset"].get<std::size_t>(),
                            values.size() * sizeof(T));
                return values;
            }
        ADD_FAILURE() << name;
        return {};
    }
};

void expect_same(const Read& live, const RenderedScan& scan, const Run& run) {
    const std::vector<float> range_m = point_ranges(scan, run.config);
    EXPECT_EQ(live.array<float>("range"), range_m);
    const Pose world{{1.0, 0.0, 0.0, 0.0}, run.log.world_offset_m};
    const std::vector<glm::vec3> points = live.array<glm::vec3>("position");
    ASSERT_EQ(points, place_points(scan, run.config, world, PointSelection::rays).position_m);
    std::vector<glm::vec3> returned_m;
    for (std::size_t i = 0; i < range_m.size(); ++i)
        if (is_ray_returned(scan.image.drop_prob[i], range_m[i])) returned_m.push_back(points[i]);
    EXPECT_EQ(returned_m, place_points(scan, run.config, world).position_m) << "as in files";
}

class LiveScan : public test::DeviceTest {
protected:
    void SetUp() override {
        DeviceTest::SetUp();
        if (!IsSkipped() && !HasFatalFailure())
            made_ = std::make_unique<BrowserScanRenderer>(
                make_small_run(), OtherRunsByName{{"other", make_small_run()}}, device());
    }
    void TearDown() override {
        made_.reset();
        DeviceTest::TearDown();
    }
    BrowserScanRenderer& scanner() { return *made_; }
    const relidar::Run& run() const { return made_->trained_run(); }
    RenderedScan rendered(const relidar::Run& run, double time_s, const Pose& offset,
                          const Weather& weather = {}) {
        ScanRenderer renderer(device(), run);
        renderer.set_weather(weather);
        return renderer.render(choose_sensor("native", run.config, run.log), time_s, offset);
    }
    TabCache tab;

private:
    std::unique_ptr<BrowserScanRenderer> made_;
};

TEST_F(LiveScan, IsWhatTheRendererGives) {
    LiveScanRequest wish;
    wish.time_s = 0.23;  // between frames
    wish.sensor_offset = {make_rotation(0.3, 0.0, 0.0), {1.0, 2.0, 0.5}};
    const Read live(scanner().render_message(tab, wish));
    EXPECT_EQ(live.header["image"], Json({16, 256}));
    expect_same(live, rendered(run(), wish.time_s, wish.sensor_offset), run());
}

/// With a network that predicts a return for every ray, the page must show exactly the
/// returns that are points of the scan.
TEST_F(LiveScan, ShowsAsManyReturnsAsTheScanHasPoints) {
    relidar::Run run = make_small_run();
    run.config.refine.enabled = true;
    run.drop_network = test::make_network_that_never_drops();
    BrowserScanRenderer scans(run, {}, device());
    const Read live(scans.render_message(tab, {.time_s = 0.2}));
    const auto drop = live.array<std::uint8_t>("drop");
    const std::size_t n = place_points(rendered(run, 0.2, {}), run.config, {}).size();
    EXPECT_LT(n, drop.size());
    EXPECT_EQ(std::size_t(std::ranges::count_if(drop, [](std::uint8_t d) { return d < 128; })), n);
}

TEST_F(LiveScan, HasTheWeatherOfEachRequest) {
    LiveScanRequest wish;
    for (const Weather& weather : {Weather{.fog_visibility_m = 30.0}, Weather{.snow_mm_h = 5.0}, Weather{}}) {
        wish.weather = weather;
        const Read live(scanner().render_message(tab, wish));
        const RenderedScan expected = rendered(run(), wish.time_s, {}, weather);
        expect_same(live, expected, run());
        if (weather.is_clear()) continue;
        const auto sources = live.array<std::int32_t>("channel_source");
        EXPECT_EQ(sources, *find_values<std::int32_t>(expected.channels, "source"));
        EXPECT_THAT(sources, testing::Contains(testing::Gt(0)));
    }
    EXPECT_EQ(scanner().page_data()["weather"]["help"], weather_help());
    EXPECT_EQ(scanner().page_data()["channels"].back()["name"], "source") << "the page can colour by it";
}

TEST_F(LiveScan, ShowsEditsAsAnEditedRunDoes) {
    ASSERT_EQ(run().scene.instances.size(), 3u);
    const std::string first = run().scene.instances[1].track, second = run().scene.instances[2].track;
    LiveScanRequest wish;
    wish.time_s = 0.2;
    wish.edits.moves[first] = {1.0, -2.0, 0.0, 15.0};
    wish.edits.removed = {second};
    const relidar::Run edited = apply_edits(run(), scanner().other_runs(), wish.edits);
    EXPECT_EQ(edited.edits.size(), 2u);
    const RenderedScan expected = rendered(edited, wish.time_s, {});
    expect_same(Read(scanner().render_message(tab, wish)), expected, run());

    wish.edits.copies = {{first, "", {5.0, 3.0, -0.9, 45.0, 3.0, -2.0, 2.0}}};
    const Read with_copy(scanner().render_message(tab, wish));
    expect_same(with_copy, rendered(apply_edits(run(), scanner().other_runs(), wish.edits), wish.time_s, {}),
                run());
    EXPECT_EQ(with_copy.header["instances"][3], first + "-copy-1");
}

TEST_F(LiveScan, ShowsActorsOfOtherRuns) {
    const std::string first = run().scene.instances[1].track;
    LiveScanRequest wish;
    wish.edits.copies = {{first, "", {5.0, 3.0, -0.9, 45.0, 0.0, 0.0, 2.0}},
                         {first, "other", {8.0, -3.0, -0.9, 0.0, 0.0, 0.0, 0.0}}};
    const relidar::Run edited = apply_edits(run(), scanner().other_runs(), wish.edits);
    EXPECT_THAT(edited.edits.back().edit, testing::StartsWith("--insert ")) << "as `relidar edit` takes it";
    const Read live(scanner().render_message(tab, wish));
    expect_same(live, rendered(edited, wish.time_s, {}), run());
    EXPECT_EQ(live.header["instances"][4], first + "-insert-1");
    wish.edits.copies[1].from = "elsewhere";
    EXPECT_THROW(scanner().render_message(tab, wish), UsageError);
}

/// The label is around the highest surfels of the background.
TEST_F(LiveScan, EditsStandingObjectsAsAnEditedRunDoes) {
    relidar::Run run = make_small_run();
    const std::vector<glm::vec3>& mean = run.scene.surfels.mean;
    const glm::vec3 highest_m = *std::ranges::max_element(
        mean.begin(), mean.begin() + run.scene.models.front().count, {}, &glm::vec3::z);
    run.log.boxes.push_back(
        {"parked", "Car", {4.0, 2.0, 1.5}, {{0.0}, {{{1.0, 0.0, 0.0, 0.0}, glm::dvec3(highest_m)}}}});
    BrowserScanRenderer scans(run, {{"other", run}}, device());
    LiveScanRequest wish;
    wish.time_s = 0.2;
    const Json shown = Read(scans.render_message(tab, wish)).header["actors"].back();
    EXPECT_EQ(shown["track"], "parked");
    EXPECT_EQ(shown["standing"], true);
    const auto expect_edited = [&] {
        const Read live(scans.render_message(tab, wish));
        expect_same(live, rendered(apply_edits(run, scans.other_runs(), wish.edits), wish.time_s, {}), run);
        EXPECT_EQ(live.header["instances"][3], "parked");
    };
    wish.edits.moves["parked"] = {1.0, -2.0, 0.0, 15.0};
    expect_edited();
    wish.edits.copies = {{"parked", "", {5.0, 3.0, -0.9, 0.0, 0.0, 0.0, 0.0}},
                         {"parked", "other", {8.0, -3.0, -0.9, 0.0, 0.0, 0.0, 0.0}}};
    expect_edited();
    wish.edits = {};
    wish.edits.removed = {"parked"};
    const Read removed(scans.render_message(tab, wish));
    expect_same(removed, rendered(apply_edits(run, scans.other_runs(), wish.edits), wish.time_s, {}), run);
}

TEST_F(LiveScan, PutsCopiesOnTheGround) {
    const BoxTrack& car = run().log.boxes.front();
    const Pose there = car.world_from_box.pose.front();  // the street is flat
    for (const char* from : {"", "other"}) {
        const ActorEdits::ActorCopy copy =
            copy_on_ground(run(), scanner().other_runs(),
                           {car.id, from, {there.translation.x - 5.0, there.translation.y + 2.0}});
        EXPECT_EQ(copy.from, from);
        EXPECT_NEAR(copy.at[0], there.translation.x - 5.0, 1e-9);
        EXPECT_NEAR(copy.at[1], there.translation.y + 2.0, 1e-9);
        EXPECT_NEAR(copy.at[2], there.translation.z, 0.05);
        EXPECT_NEAR(copy.at[4], 0.0, 1.0);
        EXPECT_NEAR(copy.at[5], 0.0, 1.0);
    }
    EXPECT_THROW(copy_on_ground(run(), scanner().other_runs(), {car.id, "", {1000.0, 1000.0}}), UsageError);
}

TEST_F(LiveScan, HidesWithoutAnEdit) {
    LiveScanRequest wish;
    wish.edits.hidden = {run().scene.instances[1].track, run().scene.instances[2].track};
    EXPECT_TRUE(apply_edits(run(), scanner().other_runs(), wish.edits).edits.empty());
    const std::vector<std::uint16_t> instance =
        Read(scanner().render_message(tab, wish)).array<std::uint16_t>("instance");
    EXPECT_THAT(instance, testing::Each(testing::AnyOf(0, 65535)));
}

TEST_F(LiveScan, SaysHowMuchTheLogHasSeen) {
    LiveScanRequest wish;
    const Json here = Read(scanner().render_message(tab, wish)).header;
    EXPECT_LT(here["unseen"].get<double>(), 0.1);
    EXPECT_FALSE(here["much_unseen"].get<bool>());
    wish.sensor_offset.translation = {0.0, 0.0, -5.0};
    const Json below = Read(scanner().render_message(tab, wish)).header;
    EXPECT_GT(below["unseen"].get<double>(), 0.9);
    EXPECT_TRUE(below["much_unseen"].get<bool>());
}

TEST_F(LiveScan, NotesTheUnseenSidesOfPlacedActors) {
    relidar::Run run = make_small_run();
    const std::string first = run.scene.instances[1].track;
    const BoxTrack& box = *find_box(run.log, first);
    run.scene.models[run.scene.instances[1].model].surface = ObservedBoxSurface(box.size_m);  // saw nothing
    BrowserScanRenderer scans(run, {}, device());
    const auto notes = [&](const ActorEdits& edits) {
        return Read(scans.render_message(tab, {.time_s = 0.2, .edits = edits})).header["actor_notes"];
    };
    EXPECT_EQ(notes({}), Json::array());
    const Json moved = notes({.moves = {{first, {1.0, 0.0, 0.0, 0.0}}}});
    ASSERT_EQ(moved.size(), 1u);
    EXPECT_THAT(moved[0].get<std::string>(), testing::HasSubstr("actor " + first + ": "));
    const Json copied = notes({.copies = {{first, "", {5.0, 3.0, -0.9, 45.0, 0.0, 0.0, 0.0}}}});
    ASSERT_EQ(copied.size(), 1u);
    EXPECT_THAT(copied[0].get<std::string>(), testing::HasSubstr("actor " + first + "-copy-1: "));
    EXPECT_EQ(notes({.moves = {{first, {0.0, 0.0, 0.0, 0.0}}}}), Json::array());
}

TEST_F(LiveScan, RefusesWhatIsNotThere) {
    LiveScanRequest wish;
    wish.sensor = "/etc/passwd";
    EXPECT_THROW(scanner().render_message(tab, wish), UsageError);
    wish.sensor = "file";
    EXPECT_THROW(scanner().render_message(tab, wish), UsageError);
    wish.sensor = "native";
    wish.lidar = 1;
    EXPECT_THROW(scanner().render_message(tab, wish), UsageError);
    wish.lidar = 0;
    wish.edits.removed = {"nobody"};
    EXPECT_THROW(scanner().render_message(tab, wish), UsageError);
    EXPECT_THROW(scanner().store_sensor(tab, {"x.npz", "x"}), UsageError);
    EXPECT_THROW(scanner().store_sensor(tab, {"x.csv", "x\n1\n"}), DataError);
    try {
        scanner().store_sensor(tab,
                               {"two.json", R"({"sensors": [{"name": "left", "sensor": "/etc/passwd"}]})"});
        ADD_FAILURE() << "a rig is accepted";
    } catch (const UsageError& error) {
        EXPECT_THAT(error.what(), testing::HasSubstr("two.json"));
    }
    EXPECT_EQ(scanner().store_sensor(tab, {"x.csv", "elevation_deg\n1\n"})["rows"], 1);
}

}  // namespace
}  // namespace relidar::view
