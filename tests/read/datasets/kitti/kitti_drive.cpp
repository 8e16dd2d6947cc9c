// SPDX-License-Identifier: Apache-2.0
// Firings of a sweep are at the encoder ticks floor(n * 4000 / 701 + wobble).
#include "read/datasets/kitti/kitti_drive.hpp"

#include <fstream>

#include <fmt/format.h>

#include "base/random.hpp"

namespace relidar::test {
namespace fs = std::filesystem;
namespace {

constexpr double kTick = 2.0 * kPi / 4000.0;

std::vector<Beam> make_beams() {
    std::vector<Beam> beams(64);
    Random random(7);
    double mean = 0.0;
    for (int k = 0; k < 64; ++k) {
        const double elevation_deg = k < 32 ? 2.0 - 0.34 * k : -9.0 - 0.51 * (k - 32);
        Beam& beam = beams[std::size_t(k)];
        beam.elevation_rad = elevation_deg * kPi / 180.0;
        beam.azimuth_offset_rad = random.sample_uniform(-0.14, 0.14);
        beam.origin_up_m = (k < 32 ? 0.20 : 0.12) * std::cos(beam.elevation_rad);
        beam.origin_left_m = k % 2 == 0 ? -0.026 : 0.026;
        mean += beam.azimuth_offset_rad / 64;
    }
    for (Beam& beam : beams) beam.azimuth_offset_rad -= mean;
    return beams;
}

double azimuth_facing(Heads heads, int firing, int frame) {
    const double even = firing * 4000.0 / KittiDrive::kFirings;
    if (heads == Heads::even) return (2000.0 - even) * kTick;
    if (heads == Heads::jittered) {
        Random random(hash_pair(std::uint64_t(firing), std::uint64_t(frame)));
        return (2000.0 - even - random.sample_uniform(0.0, 2.5)) * kTick;
    }
    const double wobble = 1.4 * std::sin(6.0 * kPi * firing / KittiDrive::kFirings) + 1.9 * frame;
    return (2000.0 - std::floor(even + wobble)) * kTick;
}

struct Sweep {
    std::string bytes;
    std::vector<glm::dvec3> dropped;
    std::size_t n_points = 0;
};

Sweep make_sweep(const std::vector<Beam>& beams, Heads heads, int frame) {
    Sweep sweep;
    for (std::size_t k = 0; k < beams.size(); ++k) {
        std::vector<std::pair<double, glm::vec4>> ring;
        for (int n = 0; n < KittiDrive::kFirings; ++n) {
            const BeamRay ray = aim_beam(beams[k], azimuth_facing(heads, n, frame));
            const double azimuth = std::atan2(ray.direction.y, ray.direction.x);
            const double reach =
                9.0 + 4.0 * std::sin(3.0 * azimuth) + 2.0 * std::cos(7.0 * azimuth + 0.3 * double(k));
            const bool drop = hash_pair(k * 1000 + std::uint64_t(n), std::uint64_t(frame)) % 10 == 0;
            if (drop) {
                sweep.dropped.push_back(ray.direction);
                continue;
            }
            const glm::dvec3 p =
                glm::round(1000.0 *
                           (ray.origin_m + reach / std::cos(beams[k].elevation_rad) * ray.direction)) /
                1000.0;
            const double full = std::atan2(p.y, p.x);
            ring.emplace_back(full < 0.0 ? full + 2.0 * kPi : full, glm::vec4(glm::vec3(p), 0.25f));
        }
        std::sort(ring.begin(), ring.end(),
                  [](const auto& first, const auto& second) { return first.first < second.first; });
        for (const auto& [azimuth, point] : ring)
            sweep.bytes.append(reinterpret_cast<const char*>(&point), sizeof(point));
        sweep.n_points += ring.size();
    }
    return sweep;
}

const Sweep& make_sweep_of(Heads heads, int frame) {
    static std::map<std::pair<Heads, int>, Sweep> made;
    const auto [at, is_new] = made.try_emplace({heads, frame});
    if (is_new) at->second = make_sweep(make_beams(), heads, frame);
    return at->second;
}

std::string timestamp(double second) {
    return second < 60.0 ? fmt::format("2011-12-31 23:59:{:012.9f}\n", second)
                         : fmt::format("2012-01-01 00:00:{:012.9f}\n", second - 60.0);
}

std::string make_tracklets() {
    const auto pose = [](double value) {
        return fmt::format(
            "<item><tx>{}</tx><ty>2</ty><tz>-1.5</tz><rx>0</rx><ry>0</ry><rz>0.5</rz><state>2</state></item>",
            value);
    };
    return "<?xml "
           "version=\"1.0\"?><boost_serialization><tracklets><count>1</count><item_version>1</"
           "item_version><item><objectType>Van</objectType><h>2</h><w>1.8</w><l>4.4</l><first_frame>1</"
           "first_frame><poses><count>2</count>" +
           pose(10) + pose(11) + "</poses><finished>1</finished></item></tracklets></boost_serialization>";
}

}  // namespace

void write_text(const fs::path& path, const std::string& text) {
    fs::create_directories(path.parent_path());
    std::ofstream(path, std::ios::binary) << text;
}

std::string read_text(const fs::path& path) {
    std::ostringstream text;
    text << std::ifstream(path, std::ios::binary).rdbuf();
    return text.str();
}

fs::path KittiDrive::scan(int frame) const {
    return folder / "velodyne_points/data" / fmt::format("{:010d}.bin", frame);
}

KittiDrive::KittiDrive(const std::string& name, Heads heads)
    : LogFolder("relidar_" + name, "2011_12_31/2011_12_31_drive_0001_sync") {
    kind = "kitti_raw:";
    beams = make_beams();
    dropped = make_sweep_of(heads, 0).dropped;
    n_points = make_sweep_of(heads, 0).n_points;
    std::array<std::string, 3> times;
    for (int frame = 0; frame < 3; ++frame) {
        write_text(scan(frame), make_sweep_of(heads, frame).bytes);
        const double second = 59.85 + 0.1 * frame;
        times[0] += timestamp(second);
        times[1] += timestamp(second - 0.05);
        times[2] += timestamp(second + 0.05);
        // The longitude increases by 1e-5 degrees per frame, which moves the car east.
        // The yaw is a quarter turn, so that the car faces north.
        std::string oxts = fmt::format("60.0 {:.10f} 100.5 0 0 {:.12f}", 8.0 + 1e-5 * frame, kPi / 2);
        for (int i = 6; i < 30; ++i) oxts += " 0";
        write_text(file(fmt::format("oxts/data/{:010d}.txt", frame)), oxts + "\n");
    }
    write_text(file("velodyne_points/timestamps.txt"), times[0]);
    write_text(file("velodyne_points/timestamps_start.txt"), times[1]);
    write_text(file("velodyne_points/timestamps_end.txt"), times[2]);
    write_text(file("tracklet_labels.xml"), make_tracklets());
    write_text(calibration(), "calib_time: 01-Jan-2012 00:00:00\nR: 1 0 0 0 1 0 0 0 1\nT: -0.8 0.3 -0.8\n");
}

}  // namespace relidar::test
