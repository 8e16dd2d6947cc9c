// SPDX-License-Identifier: Apache-2.0
#include <relidar/read/dataset.hpp>

#include <cstring>

#include <ImfChannelList.h>
#include <ImfFrameBuffer.h>
#include <ImfHeader.h>
#include <ImfOutputFile.h>

#include <relidar/base/images.hpp>
#include <relidar/log/sensor_files.hpp>

#include "read/datasets/folder/point_log.hpp"

namespace relidar {
namespace {

namespace fs = std::filesystem;

using Channels = std::map<std::string, std::vector<float>>;

Channels list_channels(const Scan& scan) {
    Channels channels{{"range", to_vector(scan.range_m)},
                      {"intensity", to_vector(scan.intensity)},
                      {"time", to_vector(scan.rays.time_offset_s)},
                      {"ring", {scan.rays.channel.begin(), scan.rays.channel.end()}}};
    for (int axis = 0; axis < 3; ++axis) {
        const std::string letter(1, "xyz"[axis]);
        for (const glm::vec3& v : scan.rays.direction) channels["direction." + letter].push_back(v[axis]);
        for (const glm::vec3& v : scan.rays.origin) channels["origin." + letter].push_back(v[axis]);
    }
    return channels;
}

/// @param keep channels that are written
struct StreetOfImages {
    Log truth = make_street_log({.n_frames = 3, .rows = 32, .columns = 500});
    fs::path folder;

    StreetOfImages(const std::string& name, const std::function<bool(const std::string&)>& keep)
        : folder(test::make_fresh_folder_path("exr_" + name)) {
        test::add_second_returns(truth, 5, 1.75f, 70.0f);
        save_folder(truth, folder);
        std::string head = test::read_text(folder / "sequence.json");
        for (std::size_t at = 0; (at = head.find(".npz", at)) != std::string::npos;)
            head.replace(at, 4, ".exr");
        test::write_text(folder / "sequence.json", head);
        for (const Frame& frame : truth.frames) {
            Channels channels = list_channels(frame.scan);
            channels["range_2"] = frame.scan.second_returns[0].range_m;
            channels["intensity_2"] = frame.scan.second_returns[0].intensity;
            std::erase_if(channels, [&](const auto& channel) { return !keep(channel.first); });
            const std::string stem = fmt::format("scans/{:06}", frame.index);
            fs::remove(folder / (stem + ".npz"));
            write_exr(folder / (stem + ".exr"), frame.scan.rays.rows, frame.scan.rays.columns, channels,
                      {{"relidar", "test"}});
        }
    }
};

void expect_same_scans(const Log& log, const Log& truth, double ray_tolerance) {
    ASSERT_EQ(log.frames.size(), truth.frames.size());
    for (std::size_t f = 0; f < truth.frames.size(); ++f) {
        const Scan &a = log.frames[f].scan, &b = truth.frames[f].scan;
        ASSERT_EQ(std::tuple(a.rays.rows, a.rays.columns), std::tuple(b.rays.rows, b.rays.columns));
        EXPECT_EQ(a.rays.channel, b.rays.channel);
        EXPECT_EQ(a.intensity, b.intensity);
        ASSERT_EQ(a.second_returns.size(), 1u);
        EXPECT_TRUE(a.range_m == b.range_m && a.second_returns[0].range_m == b.second_returns[0].range_m);
        EXPECT_EQ(a.second_returns[0].intensity, b.second_returns[0].intensity);
        std::size_t n_returns = 0;
        for (std::size_t i = 0; i < b.range_m.size(); ++i) {
            EXPECT_LE(glm::distance(a.rays.direction[i], b.rays.direction[i]), ray_tolerance);
            EXPECT_LE(glm::distance(a.rays.origin[i], b.rays.origin[i]), ray_tolerance);
            EXPECT_NEAR(a.rays.time_offset_s[i], b.rays.time_offset_s[i], 1e-6);
            n_returns += b.range_m[i] > 0.0f;
        }
        EXPECT_GT(n_returns, b.range_m.size() / 2);
    }
}

TEST(ExrFolder, ImagesWithRaysAreReadBitByBit) {
    const StreetOfImages street("whole", [](const std::string&) { return true; });
    expect_same_scans(load_log(street.folder.string(), {}), street.truth, 0.0);
}

TEST(ExrFolder, ImagesWithoutRaysTakeThoseOfTheSensor) {
    const auto keep = [](const std::string& name) {
        return name.starts_with("range") || name.starts_with("intensity");
    };
    const StreetOfImages street("sensor", keep);
    const Log log = load_log(street.folder.string(), {});
    expect_same_scans(log, street.truth, 1e-6);  // 0.1 mm at 80 m
}

TEST(ExrFolder, RowsFromBelow) {
    const std::string head = R"({"format": "relidar log", "version": 1, "rate_hz": 10, "lidars": [{"RING"
        "sensor": {"beams": [{"elevation_deg": 5}, {"elevation_deg": 0}, {"elevation_deg": -5}], "columns": 4, "period_s": 0.1}}]})";
    const auto ranges = [&](const std::string& ring) {
        std::string text = head;
        const fs::path folder =
            test::make_frame_folder("below", text.replace(text.find("\"RING\""), 6, ring));
        write_exr(folder / "scans/0.exr", 3, 4, {{"range", {1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12}}});
        const Scan scan = load_log(folder.string(), {}).frames[0].scan;
        EXPECT_NEAR(scan.rays.direction[0].z, std::sin(5.0 * kPi / 180.0), 1e-6)
            << "row 0 is the highest beam in either case";
        return scan.range_m;
    };
    EXPECT_EQ(ranges(R"("ring_0": "highest",)"), (ScanArray<float>{1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12}));
    EXPECT_EQ(ranges(R"("ring_0": "lowest",)"), (ScanArray<float>{9, 10, 11, 12, 5, 6, 7, 8, 1, 2, 3, 4}));
}

TEST(ExrFolder, TheSensorThatAFileNames) {
    const fs::path folder = test::make_frame_folder("named");
    const SensorModel sensor = find_sensor("VLP-16:180x10");
    const RayTable rays = make_rays(sensor);
    const std::vector<float> range(rays.size(), 12.0f);
    write_exr(folder / "scans/0.exr", 16, 180, {{"range", range}}, {{"sensor", "VLP-16:180x10"}});
    const Scan scan = load_log(folder.string(), {}).frames[0].scan;
    EXPECT_TRUE(scan.rays.direction == rays.direction && scan.rays.origin == rays.origin &&
                scan.rays.channel == rays.channel);
    write_exr(folder / "scans/0.exr", 16, 180, {{"range", range}}, {{"sensor", "/etc/passwd.csv"}});
    EXPECT_THROW(load_log(folder.string(), {}), DataError)
        << "a file of the user's is not read because an image says so";
}

/// Half precision or integers, other compressions, a window that does not start at 0.
TEST(ExrFolder, ImagesOfOtherPrograms) {
    constexpr int rows = 40, columns = 30, n = rows * columns;
    const fs::path folder = test::make_frame_folder(
        "others", R"({"format": "relidar log", "version": 1, "rate_hz": 10, "intensity_max": 1000,
        "lidars": [{"sensor": "rays.json", "spins": false}]})");
    std::string directions;
    for (int i = 0; i < n; ++i)
        directions +=
            fmt::format("{}[{}, {}, 0]", i == 0 ? "" : ", ", std::cos(0.001 * i), std::sin(0.001 * i));
    test::write_text(folder / "rays.json", fmt::format(R"({{"directions": [{}]}})", directions));
    std::vector<Imath::half> range(n);
    std::vector<unsigned> intensity(n);
    for (std::size_t i = 0; i < range.size(); ++i) {
        range[i] = Imath::half(float(i % 2048) / 32.0f);
        intensity[i] = unsigned(i % 1000);
    }
    for (const Imf::Compression compression :
         {Imf::NO_COMPRESSION, Imf::RLE_COMPRESSION, Imf::ZIPS_COMPRESSION, Imf::PIZ_COMPRESSION}) {
        const Imath::Box2i window({-7, 11}, {-7 + n - 1, 11});
        Imf::Header header(window, window);
        header.compression() = compression;
        header.channels().insert("range", Imf::Channel(Imf::HALF));
        header.channels().insert("intensity", Imf::Channel(Imf::UINT));
        Imf::FrameBuffer buffer;
        buffer.insert("range", Imf::Slice::Make(Imf::HALF, range.data(), window));
        buffer.insert("intensity", Imf::Slice::Make(Imf::UINT, intensity.data(), window));
        {
            Imf::OutputFile file((folder / "scans/0.exr").c_str(), header);
            file.setFrameBuffer(buffer);
            file.writePixels(1);
        }
        const Scan scan = load_log(folder.string(), {}).frames[0].scan;
        ASSERT_EQ(scan.range_m.size(), std::size_t(n));
        for (std::size_t i = 1; i < std::size_t(n); ++i) {
            ASSERT_EQ(scan.range_m[i], float(i % 2048) / 32.0f) << i;
            ASSERT_FLOAT_EQ(scan.intensity[i], float(i % 1000) / 1000.0f) << i;
        }
    }
}

class ExrDamage : public testing::Test {
protected:
    const fs::path folder = test::make_frame_folder("damage");
    const fs::path file = folder / "scans/a.exr";
    const int rows = 20, columns = 12;

    Channels good() const {
        Channels channels;
        for (int i = 0; i < rows * columns; ++i) {
            const double a = 0.01 * i;
            channels["range"].push_back(5.0f + 0.01f * float((i * 7919) % 997));
            channels["intensity"].push_back(0.5f);
            channels["direction.x"].push_back(float(std::cos(a)));
            channels["direction.y"].push_back(float(std::sin(a)));
            channels["direction.z"].push_back(0.0f);
        }
        return channels;
    }
    std::string complaint() const {
        const std::string said = test::find_load_error("folder:" + folder.string());
        EXPECT_TRUE(said == "nothing" || said.find(file.string()) != said.npos) << said;
        return said;
    }
    void expect(const Channels& channels, const std::string& part, const FileMetadata& notes = {}) const {
        write_exr(file, rows, columns, channels, notes);
        EXPECT_THAT(complaint(), test::Names(part));
    }
    void expect_bytes(const std::string& bytes, const std::string& part) const {
        test::write_text(file, bytes);
        EXPECT_THAT(complaint(), test::Names(part));
    }
    std::string read_good_bytes() const {
        write_exr(file, rows, columns, good());
        EXPECT_EQ(complaint(), "nothing");
        return test::read_text(file);
    }
    /// The attribute is found by name and type.
    /// @param offset offset in the value; -4 changes the size of the attribute
    std::string patch_bytes(const std::string& bytes, const std::string& name, const std::string& type,
                            int offset, std::int32_t value) const {
        std::string changed = bytes;
        const std::size_t begin = bytes.find(name + '\0' + type + '\0');
        EXPECT_NE(begin, std::string::npos);
        std::memcpy(changed.data() + std::ptrdiff_t(begin + name.size() + type.size() + 2 + 4) + offset,
                    &value, sizeof value);
        return changed;
    }
};

TEST_F(ExrDamage, CutAnywhere) {
    const std::string bytes = read_good_bytes();
    for (std::size_t n = 0; n < bytes.size(); n += n < 700 ? 1 : 37) {
        test::write_text(file, bytes.substr(0, n));
        ASSERT_NE(complaint(), "nothing") << n << " bytes of " << bytes.size();
    }
    test::write_text(file, bytes.substr(0, bytes.size() - 1));
    EXPECT_NE(complaint(), "nothing");
    expect_bytes(bytes.substr(0, 100), "a.exr ... truncated");
    expect_bytes("", "a.exr ... truncated");
    expect_bytes("P6 20 12", "an OpenEXR file");
}

TEST_F(ExrDamage, OfHeaders) {
    const std::string bytes = read_good_bytes();
    const auto window = [&](int at, std::int32_t value) {
        return patch_bytes(bytes, "dataWindow", "box2i", at, value);
    };
    expect_bytes(window(8, 1 << 28), "pixels ... 16777216");
    expect_bytes(window(8, 400'000), "20 x 400001 pixels with 5 channels");
    expect_bytes(window(8, 2147483647), "dataWindow ... 2147483647");
    expect_bytes(window(8, -5), "20 x -4 pixels");
    expect_bytes(window(-4, 2147483647), "truncated");
    expect_bytes(window(-4, -1), "attribute 'dataWindow' ... -1 bytes");
    expect_bytes(patch_bytes(bytes, "pixelAspectRatio", "float", -4, 8),
                 "attribute 'pixelAspectRatio' of type 'float' has 8 bytes, expected 4");
    // The size is larger than the channel list, so that OpenEXR would read beyond the
    // list.
    std::int32_t list_bytes = 0;
    const std::string list = std::string("channels") + '\0' + "chlist" + '\0';
    std::memcpy(&list_bytes, bytes.data() + bytes.find(list) + list.size(), sizeof list_bytes);
    expect_bytes(patch_bytes(bytes, "channels", "chlist", -4, list_bytes + 9), "channels ... size");
    std::string other = bytes;
    for (const char kind : {'\x02', '\x08', '\x10'}) {  // tiles, deep data, several images
        other[5] = kind;
        expect_bytes(other, "tiles, several images, or deep data");
    }
    other = bytes;
    other[bytes.find(std::string("range\0\2", 7)) + 6] = 9;  // the pixel type
    EXPECT_NE((test::write_text(file, other), complaint()), "nothing");
    other = bytes;
    other[bytes.find(std::string("range\0\2", 7)) + 14] = 2;  // every second pixel
    expect_bytes(other, "channel 'range' ... subsampled ... 2 x 1");
    other = bytes;
    for (std::size_t at = bytes.size() - 60; at < bytes.size(); ++at) other[at] = char(0xAA);
    EXPECT_NE((test::write_text(file, other), complaint()), "nothing") << "pixels that do not unpack";
}

TEST_F(ExrDamage, OfValues) {
    const auto with = [&](const std::string& name, float value) {
        Channels channels = good();
        channels[name].resize(std::size_t(rows * columns), 0.0f);
        channels[name][7] = value;
        return channels;
    };
    expect(with("range", 2e6f), "ray 7 ... 2000000");
    for (const float range_m : {NAN, -1.0f, INFINITY, -INFINITY}) expect(with("range", range_m), "nothing");
    expect(with("intensity", 51.0f), "51 ... 0 ... 1 ... \"intensity_max\"");
    expect(with("intensity", -0.5f), "ray 7 ... -0.5 ... at least 0");
    expect(with("time", NAN), "ray 7 ... time ... nan");
    expect(with("ring", 0.5f), "ray 7 ... ring ... 0.5");
}

TEST_F(ExrDamage, OfWhatIsMissing) {
    const auto without = [&](const std::string& name) {
        Channels channels = good();
        channels.erase(name);
        return channels;
    };
    expect(without("range"), "'range' ... direction.x, direction.y, direction.z, intensity");
    expect(without("direction.y"), "2 ... direction.x, .y and .z");
    const Channels range{{"range", good()["range"]}};
    expect(range, "directions");
    expect(good(), "motion-compensated", {{"points_in", "world: the dataset's own"}});
    expect(good(), "motion-compensated", {{"points_in", "sensor at time_s: x forward, y left, z up"}});
    expect(good(), "nothing", {{"points_in", "sensor at each ray's firing time: x forward, y left, z up"}});
    test::write_text(folder / "sequence.json", test::make_head(R"(, "lidars": [{"sensor": "VLP-16"}])"));
    expect(range, "range ... 20 x 12 ... 16 x 1808");
}

}  // namespace
}  // namespace relidar
