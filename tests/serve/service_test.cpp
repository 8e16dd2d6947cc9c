// SPDX-License-Identifier: Apache-2.0
// Responses must equal the scans of ScanRenderer bit by bit.

#include <relidar/base/arrays.hpp>
#include <relidar/simulate/render.hpp>
#include <relidar/simulate/scan_files.hpp>

#include "../../tools/network/loopback.hpp"
#include "../../tools/view/frame.hpp"
#include "small_service.hpp"

namespace relidar::serve {
namespace {

class Service : public ServiceTest {
protected:
    RenderedScan rendered(const ScanRequest& request, const std::string& sensor,
                          std::optional<std::uint64_t> sample, const std::string& in_weather = "") {
        const relidar::Run run = load_run(folder / "small");
        ScanRenderer renderer(device(), run);
        renderer.set_weather(parse_weather(in_weather));
        const SimulatedSensor choice =
            sensor.empty() ? make_sensor(run.config, run.log) : choose_sensor(sensor, run.config, run.log);
        return renderer.render(choice, request, sample);
    }
    static void expect_same(const v1::LidarScan& scan, const RenderedScan& truth) {
        EXPECT_EQ(values<float>(scan.image().range_m()), truth.image.range_m);
        EXPECT_EQ(values<float>(scan.image().intensity()), truth.image.intensity);
        EXPECT_EQ(values<float>(scan.image().drop_probability()), truth.image.drop_prob);
        EXPECT_EQ(int(scan.image().rows()), truth.image.rows);
        EXPECT_EQ(int(scan.image().columns()), truth.image.columns);
        EXPECT_EQ(scan.rays(), truth.image.range_m.size());
        EXPECT_EQ(scan.unseen(), truth.unseen_share.value());
        std::uint32_t returned = 0;
        for (std::size_t i = 0; i < truth.image.range_m.size(); ++i)
            returned += truth.image.drop_prob[i] < 0.5f && truth.image.range_m[i] > 0.0f;
        EXPECT_EQ(scan.returned(), returned);
    }
};

const char* const kPointsAlone = "wanted { range_image: false drop_probability: false }";

Pose turned_at_x(double x_m) {
    return {glm::normalize(glm::dquat(1.0, 0.01, 0.02, 0.1)), make_pose_at_x(x_m).translation};
}

void add_actor(v1::RenderLidarRequest& request, const std::string& name, const PoseTrack& track) {
    v1::ActorTrack& actor = *request.mutable_actors()->add_actors();
    actor.set_name(name);
    write_track(track, *actor.mutable_poses());
}

TEST_F(Service, RendersToTheBitAsTheLibrary) {
    start();
    const PoseTrack sensor_path{{0.3, 0.45, 0.6},
                                {make_pose_at_x(-2.0), make_pose_at_x(-1.0), turned_at_x(0.0)}};
    const PoseTrack car{{0.4, 0.5}, {make_pose_at_x(5.0), make_pose_at_x(6.0)}};
    v1::RenderLidarRequest request = make_standing_request();
    set_path(request, sensor_path);
    request.set_time_s(0.45);
    expect_same(scan_of(request), rendered({0.45, sensor_path}, "", {}));

    add_actor(request, "car", car);
    request.mutable_sensor()->set_name("VLP-16:90x10");
    expect_same(scan_of(request),
                rendered({0.45, sensor_path, ActorTracksByName{{"car", car}}}, "VLP-16:90x10", {}));

    request.mutable_actors()->clear_actors();
    request.set_sample_seed(7);
    expect_same(scan_of(request), rendered({0.45, sensor_path, ActorTracksByName{}}, "VLP-16:90x10", 7));
}

/// Returns the positions in a binary PLY file. A point has 26 bytes: x, y, z, intensity,
/// ring (2 bytes), time and instance.
std::vector<float> read_ply_positions(const std::filesystem::path& path) {
    constexpr std::size_t kPointBytes = 26;
    std::string text = read_contents(path);
    text.erase(0, text.find("end_header\n") + 11);
    EXPECT_EQ(text.size() % kPointBytes, 0u);
    std::string positions;
    for (std::size_t i = 0; i < text.size(); i += kPointBytes) positions += text.substr(i, 12);
    return values<float>(positions);
}

std::vector<float> list_returned_positions(const std::vector<float>& ends, const RenderedScan& scan) {
    std::vector<float> positions;
    for (std::size_t i = 0; i < scan.median_range_m.size(); ++i)
        if (is_ray_returned(scan.image.drop_prob[i], scan.median_range_m[i]))
            positions.insert(positions.end(), {ends[3 * i], ends[3 * i + 1], ends[3 * i + 2]});
    return positions;
}

/// Compares the points of the service with the points in files, of the viewer, and of
/// Python's Run.render(), which returns scan_arrays(). The sensor moves and turns.
/// At the time of the scan its frame is the world frame of the scene, so that the viewer
/// uses the same frame.
TEST_F(Service, PointsAreThoseOfFilesViewerAndPython) {
    start();
    const PoseTrack sensor_path{{0.3, 0.45, 0.6},
                                {make_pose_at_x(-2.0), make_pose_at_x(0.0), turned_at_x(1.3)}};
    v1::RenderLidarRequest request = make_standing_request();
    set_path(request, sensor_path);
    request.set_time_s(0.45);
    request.set_points_at_s(0.45);
    const std::vector<float> beside_image = values<float>(scan_of(request).points().xyz_m());
    ASSERT_GT(beside_image.size(), 60u);
    merge(request, kPointsAlone);
    EXPECT_EQ(values<float>(scan_of(request).points().xyz_m()), beside_image) << "without an image";

    const relidar::Run run = load_run(folder / "small");
    const RenderedScan scan = rendered({0.45, sensor_path}, "", {});
    ScanOutputOptions format = default_options(run, make_sensor(run.config, run.log));
    format.formats = {"ply"};
    format.deskew = true;
    ScanFolderWriter(folder / "files", format).write_scan(0, scan);
    EXPECT_EQ(read_ply_positions(folder / "files" / "frame_000000.ply"), beside_image)
        << "render --format ply";

    const view::ScanColumns in_viewer = view::simulated_columns(scan, run.config, kDatasetOrigin_m);
    std::vector<float> ends;
    for (const glm::vec3& end : in_viewer.position_m) ends.insert(ends.end(), {end.x, end.y, end.z});
    EXPECT_EQ(list_returned_positions(ends, scan), beside_image) << "viewer";

    const std::vector<NamedArray> arrays = scan_arrays(scan, 0, format);
    const auto of_python = std::ranges::find(arrays, "points", &NamedArray::name);
    ASSERT_NE(of_python, arrays.end());
    EXPECT_EQ(list_returned_positions(of_python->to_floats(), scan), beside_image) << "Python";
}

/// Each request is rendered with the weather in the request. A request without weather
/// uses the server's weather. A request must not change the weather of the next request.
TEST_F(Service, WeatherIsThatOfTheRequest) {
    weather = parse_weather("snow=4");
    start();
    v1::RenderLidarRequest request = make_standing_request();
    request.mutable_actors();
    request.set_time_s(0.5);
    const PoseTrack sensor_path{{0.5}, {make_pose_at_x(0.0)}};
    for (const char* requested_weather : {"fog=20", "", "clear", "rain=80,fog=300", "clear"}) {
        for (const std::uint64_t seed : {1, 2}) {
            request.set_weather(requested_weather);
            request.set_sample_seed(seed);
            const std::string expected = requested_weather[0] == 0 ? "snow=4" : requested_weather;
            const v1::LidarScan scan = scan_of(request);
            const RenderedScan truth = rendered({0.5, sensor_path, ActorTracksByName{}}, "", seed, expected);
            expect_same(scan, truth);
            const std::vector<std::int32_t>* sources = find_values<std::int32_t>(truth.channels, "source");
            ASSERT_EQ(scan.image().channels_size(), sources ? 1 : 0) << expected;
            ASSERT_EQ(sources == nullptr, expected == "clear");
            if (!sources) continue;
            EXPECT_EQ(scan.image().channels(0).name(), "source");
            EXPECT_EQ(values<std::int32_t>(scan.image().channels(0).values()), *sources);
            EXPECT_THAT(*sources, testing::Contains(testing::Gt(0))) << expected;
            EXPECT_THAT(values<std::int32_t>(scan.points().channels(0).values()),
                        testing::Each(testing::Ge(0)));
        }
    }
}

TEST_F(Service, PointsLieOnThingsSeenFromTheEndOfTheSweep) {
    start();
    v1::RenderLidarRequest request = make_standing_request();
    const Pose begin = make_pose_at_x(-1.0),
               end{make_rotation(0.2, 0.0, 0.0), make_pose_at_x(0.0).translation + glm::dvec3(0.0, 0.5, 0.0)};
    set_path(request, {{0.45, 0.55}, {begin, end}});
    request.mutable_actors();  // removes all actors, so that only the wall is visible
    const v1::LidarScan scan = scan_of(request);
    EXPECT_EQ(scan.points_at_s(), 0.55);
    EXPECT_NEAR(scan.time_s() + values<float>(scan.points().time_s()).front(), 0.55, 0.1);
    const std::vector<glm::vec3> points = values<glm::vec3>(scan.points().xyz_m());
    ASSERT_GT(points.size(), 10u);
    EXPECT_EQ(points.size(), scan.points().count());
    for (const glm::vec3& point : points)
        EXPECT_NEAR((end * glm::dvec3(point)).x, kDatasetOrigin_m.x + 10.0, 2e-4)
            << "on the wall, whenever its ray was fired";
    for (const std::string* bytes :
         {&scan.points().intensity(), &scan.points().time_s(), &scan.points().instance()})
        EXPECT_EQ(bytes->size(), 4 * points.size());
    EXPECT_EQ(scan.points().ring().size(), 2 * points.size());
    EXPECT_THAT(values<std::uint8_t>(scan.points().return_number()), testing::Each(1));
    EXPECT_THAT(values<std::int32_t>(scan.points().instance()), testing::Each(0));
    EXPECT_THAT(values<std::uint16_t>(scan.points().ring()), testing::Contains(2));
}

/// Requests points without an image, which the device computes, and points with an image,
/// which the host computes. Both must be equal. The wall faces the sensor, so its normal
/// is -x of the world, in the frame of the points.
TEST_F(Service, PointsAloneAreThoseBesideAnImage) {
    start();
    v1::RenderLidarRequest request = make_standing_request();
    set_path(request, {{0.3, 0.6}, {make_pose_at_x(-2.0), turned_at_x(0.0)}});
    merge(request, "time_s: 0.45 points_at_s: 0.5 sensor { name: 'VLP-16:90x10' }");
    for (const bool sampled : {false, true}) {
        if (sampled) request.set_sample_seed(3);
        const v1::LidarScan both = scan_of(merge(request, "wanted { range_image: true }"));
        const v1::LidarScan alone = scan_of(merge(request, kPointsAlone));
        EXPECT_FALSE(alone.has_image());
        EXPECT_EQ(alone.unseen(), both.unseen());
        EXPECT_EQ(alone.rays(), both.rays());
        EXPECT_EQ(alone.returned(), both.points().count());
        const auto &p = alone.points(), &e = both.points();
        ASSERT_GT(p.count(), 10u);
        EXPECT_EQ(p.SerializeAsString(), e.SerializeAsString());
    }
}

/// The response must contain the boxes of the request, with the number of points in each
/// box. The car drives away from the sensor. A copy of the car is behind the wall.
TEST_F(Service, BoxesAreThoseOfTheRequestAndCountItsPoints) {
    start();
    const auto [status, spawned] = call(
        *calls, &Stub::SpawnActors, parse<v1::SpawnActorsRequest>("actors { name: 'hidden' actor: 'car' }"));
    ASSERT_TRUE(status.ok());
    v1::RenderLidarRequest request = make_standing_request();
    merge(request, "time_s: 0.5 sensor { name: 'VLP-16:3600x10' }");
    for (const auto& [name, x_m] : {std::pair("car", 4.0), std::pair("hidden", 12.0)})
        add_actor(request, name, {{0.4, 0.6}, {make_pose_at_x(x_m), make_pose_at_x(x_m + 1.0)}});
    EXPECT_EQ(scan_of(request).boxes_size(), 0) << "not requested";
    const v1::LidarScan scan = scan_of(merge(merge(request, kPointsAlone), "wanted { boxes: true }"));
    ASSERT_EQ(scan.boxes_size(), 2);
    const v1::ActorBox &car = scan.boxes(0), &hidden = scan.boxes(1);
    EXPECT_EQ(car.name() + hidden.name(), "carhidden");
    EXPECT_EQ(car.category() + car.label() + hidden.category(), "CarCarCar");
    EXPECT_FALSE(car.is_discovered());
    EXPECT_EQ(hidden.size_m().y(), 1.0);
    EXPECT_NEAR(car.time_s(), 0.5, 1e-3) << "the sensor faces ahead at the time of the scan";
    const double travelled_m = 5.0 * (car.time_s() - 0.4);
    EXPECT_NEAR(car.dataset_from_box().translation().x() - kDatasetOrigin_m.x, 4.0 + travelled_m, 1e-6);
    EXPECT_NEAR(car.velocity_mps().x(), 5.0, 1e-4);
    const std::vector<std::int32_t> instances = values<std::int32_t>(scan.points().instance());
    EXPECT_EQ(car.points(), std::uint64_t(std::ranges::count(instances, 1)));
    EXPECT_EQ(hidden.points(),
              std::uint64_t(std::ranges::count(instances, std::int32_t(spawned.actors(0).instance()))));
    EXPECT_GT(car.points(), 100u);
    EXPECT_NEAR(car.visible_share(), 1.0, 0.02);
    EXPECT_EQ(hidden.visible_share(), 0.0);
}

TEST_F(Service, ChannelsComeWithPointsAndImage) {
    channels = "normal,spread";
    start();
    v1::RenderLidarRequest request = make_standing_request();
    const Pose begin = make_pose_at_x(-1.0),
               end{make_rotation(0.4, 0.0, 0.0), make_pose_at_x(0.0).translation};
    set_path(request, {{0.45, 0.55}, {begin, end}});
    request.mutable_actors();
    const v1::LidarScan scan = scan_of(request);
    ASSERT_EQ(scan.points().channels_size(), 2);
    const v1::Channel &normal = scan.points().channels(0), &spread = scan.points().channels(1);
    EXPECT_EQ(normal.name(), "normal");
    EXPECT_EQ(normal.components(), 3u);
    EXPECT_EQ(spread.name(), "spread");
    EXPECT_EQ(spread.unit(), "m");
    EXPECT_EQ(spread.components(), 1u);
    const std::vector<glm::vec3> normals = values<glm::vec3>(normal.values());
    ASSERT_EQ(normals.size(), scan.points().count());
    ASSERT_GT(normals.size(), 10u);
    for (const glm::vec3& n : normals)
        EXPECT_LT(glm::distance(end.rotation * glm::dvec3(n), glm::dvec3(-1.0, 0.0, 0.0)), 1e-4);
    EXPECT_EQ(values<float>(spread.values()).size(), scan.points().count());
    ASSERT_EQ(scan.image().channels_size(), 2);
    EXPECT_EQ(values<float>(scan.image().channels(1).values()).size(), scan.rays());
}

TEST_F(Service, FirstRayIsFiredAtTheBeginningOfThePathUnlessToldOtherwise) {
    start();
    v1::RenderLidarRequest request = make_standing_request();
    v1::SensorSpec spec = make_rays_ahead(3);
    const std::vector<float> fired_s{0.25f, 0.5f, 0.75f};
    spec.mutable_rays()->set_time_s(fired_s.data(), 12);
    *request.mutable_sensor()->mutable_spec() = spec;
    set_path(request, {{0.0, 0.5}, {make_pose_at_x(-4.0), make_pose_at_x(-3.0)}});  // 2 m/s
    request.mutable_actors();
    const v1::LidarScan scan = scan_of(request);
    EXPECT_EQ(scan.time_s(), -0.25);
    const std::vector<float> range_m = values<float>(scan.image().range_m());
    ASSERT_EQ(range_m.size(), 3u);
    for (std::size_t i = 0; i < 3; ++i) EXPECT_NEAR(range_m[i], 14.0 - 0.5 * double(i), 1e-3) << "ray " << i;
    request.set_time_s(0.0);
    EXPECT_NEAR(values<float>(scan_of(request).image().range_m())[0], 13.5, 1e-3);
}

TEST_F(Service, ActorsAreTheLogsOrTheClients) {
    start();
    v1::RenderLidarRequest request = make_standing_request();
    *request.mutable_sensor()->mutable_spec() = make_rays_ahead(1);
    const auto range_m = [&] { return double(values<float>(scan_of(request).image().range_m())[0]); };
    const auto instance = [&] { return values<std::int32_t>(scan_of(request).points().instance()).at(0); };
    EXPECT_NEAR(range_m(), 4.0, 0.05) << "where the log has it";
    EXPECT_EQ(instance(), 1) << "the first of Scene.actors";
    add_actor(request, "car", {{0.0}, {make_pose_at_x(6.0)}});
    EXPECT_NEAR(range_m(), 6.0, 0.05) << "where the client has it";
    request.mutable_actors()->clear_actors();
    // the track of the car ends 0.5 s before the scan
    add_actor(request, "car", {{-0.5, 0.0}, {make_pose_at_x(4.0), make_pose_at_x(5.0)}});
    EXPECT_NEAR(range_m(), 6.0, 0.05) << "it goes on at the same speed";
    request.mutable_actors()->clear_actors();
    EXPECT_NEAR(range_m(), 10.0, 0.05) << "nobody is there";
    EXPECT_EQ(instance(), 0);
}

TEST_F(Service, SensorIsUploadedOnce) {
    start();
    const auto upload = parse<v1::UploadSensorRequest>(
        "sensor { spinning { beams { elevation_rad: 0.05 } beams { elevation_rad: -0.05 } "
        "columns: 180 period_s: 0.05 } }");
    const auto [status, uploaded] = call(*calls, &Stub::UploadSensor, upload);
    ASSERT_TRUE(status.ok());
    EXPECT_EQ(uploaded.rays(), 360u);
    EXPECT_NEAR(uploaded.last_ray_s() - uploaded.first_ray_s(), 0.05, 0.001);
    v1::RenderLidarRequest request = make_standing_request(), by_spec = request;
    request.mutable_sensor()->set_handle(uploaded.handle());
    *by_spec.mutable_sensor()->mutable_spec() = upload.sensor();
    const v1::LidarScan scan = scan_of(request);
    EXPECT_EQ(scan.image().rows(), 2u);
    EXPECT_EQ(scan.image().columns(), 180u);
    EXPECT_EQ(scan.image().range_m(), scan_of(by_spec).image().range_m());
}

/// Uses more sensors than are submitted to the device together. The scan of a remaining
/// sensor must be computed on the host. Sensors with an image are rendered one by one.
TEST_F(Service, ScansOfARigAreThoseOfEachSensorAlone) {
    start();
    for (const char* wanted : {"points: true", "range_image: true"}) {
        v1::RenderRigRequest request;
        *request.mutable_rig() = make_standing_request();
        *request.mutable_rig()->mutable_wanted() = parse<v1::Wanted>(wanted);
        for (int i = 0; i < 13; ++i) {
            v1::RigSensor& sensor = *request.add_sensors();
            sensor.set_name(std::to_string(i));
            if (i == 3) sensor.mutable_sensor()->set_name("rosette");
            else *sensor.mutable_sensor()->mutable_spec() = make_rays_ahead(std::size_t(1 + i % 3));
            sensor.mutable_rig_from_sensor()->mutable_translation()->set_x(0.5 * i - 5.0);
        }
        grpc::ClientContext context;
        const auto reader = calls->RenderRig(&context, request);
        int n_read = 0;
        for (v1::RigScan scan; reader->Read(&scan); ++n_read) {
            const v1::RigSensor& sensor = request.sensors(n_read);
            EXPECT_EQ(scan.name(), sensor.name());
            v1::RenderLidarRequest alone = request.rig();
            *alone.mutable_sensor() = sensor.sensor();
            for (v1::TimedPose& pose : *alone.mutable_path()) {
                v1::Vector& at = *pose.mutable_pose()->mutable_translation();
                at.set_x(at.x() + sensor.rig_from_sensor().translation().x());
            }
            const v1::LidarScan expected = scan_of(alone);
            EXPECT_GT(expected.points().count() + expected.image().columns(), 0u) << n_read;
            EXPECT_EQ(scan.scan().points().SerializeAsString(), expected.points().SerializeAsString())
                << n_read;
            EXPECT_EQ(scan.scan().image().SerializeAsString(), expected.image().SerializeAsString())
                << n_read;
        }
        EXPECT_TRUE(reader->Finish().ok());
        EXPECT_EQ(n_read, request.sensors_size());
    }
}

TEST_F(Service, TellsWhatItServes) {
    start(64, {"small", "other"});
    const v1::ListScenesResponse list = call(*calls, &Stub::ListScenes, {}).answer;
    ASSERT_EQ(list.scenes_size(), 2);
    EXPECT_THAT(list.scenes(1), IsMessage(R"(name: "other" end_s: 1
        lidars { sensor: "small" rays: 192 period_s: 0.1 }
        actors { name: "car" category: "Car" label: "Car" size_m { x: 1 y: 1 z: 1 } end_s: 1 poses: 2 })"));
    EXPECT_THAT(list.sensors(), testing::Contains("VLP-16"));
    const v1::GetTracksResponse tracks =
        call(*calls, &Stub::GetTracks, parse<v1::GetTracksRequest>("scene: 'other'")).answer;
    ASSERT_EQ(tracks.dataset_from_sensor_size(), 3);
    EXPECT_EQ(tracks.dataset_from_sensor(2).pose().translation().x(), kDatasetOrigin_m.x);
    ASSERT_EQ(tracks.actors_size(), 1);
    EXPECT_EQ(tracks.actors(0).poses(1).pose().translation().x(), kDatasetOrigin_m.x + 4.0);
}

TEST(Addresses, OnlyThoseOfThisMachineAreLoopback) {
    for (const char* host : {"127.0.0.1", "127.8.9.1", "localhost", "[::1]", "::1"})
        EXPECT_TRUE(is_loopback(host)) << host;
    for (const char* host : {"0.0.0.0", "[::]", "127.example.com", "10.0.0.1", "127.1"})
        EXPECT_FALSE(is_loopback(host)) << host;
}

}  // namespace
}  // namespace relidar::serve
