// SPDX-License-Identifier: Apache-2.0

#include <algorithm>
#include <array>
#include <cctype>
#include <cmath>
#include <map>

#include <relidar/scene/labels.hpp>
#include <relidar/scene/scene.hpp>
#include <relidar/simulate/actor_boxes.hpp>
#include <relidar/simulate/place_points.hpp>

#include "simulate/scan_files/layouts/layout.hpp"
#include "simulate/scan_files/recorded_moment.hpp"

namespace relidar::layouts {
namespace {

struct NamesOfWord {
    const char* word;
    ObjectNames names;
};
/// The first word that a category contains decides, so "caravan" precedes "van".
constexpr NamesOfWord kNamesOfWords[] = {{"caravan", {"Misc", "vehicle.trailer", 20, 259}},
                                         {"trailer", {"Misc", "vehicle.trailer", 20, 259}},
                                         {"bus", {"Misc", "vehicle.bus.rigid", 13, 257}},
                                         {"truck", {"Truck", "vehicle.truck", 18, 258}},
                                         {"large_vehicle", {"Truck", "vehicle.truck", 18, 258}},
                                         {"tram", {"Tram", "vehicle.train", 16, 256}},
                                         {"train", {"Tram", "vehicle.train", 16, 256}},
                                         {"van", {"Van", "vehicle.car", 10, 252}},
                                         {"motorcycl", {"Cyclist", "vehicle.motorcycle", 32, 255}},
                                         {"sitting", {"Person_sitting", "human.pedestrian.adult", 30, 254}}};
/// [ObjectKind] names of categories without such a word
constexpr ObjectNames kNamesOfKinds[] = {{"Car", "vehicle.car", 10, 252},
                                         {"Cyclist", "vehicle.bicycle", 31, 253},
                                         {"Pedestrian", "human.pedestrian.adult", 30, 254},
                                         {"Misc", "other", 99, 259}};

/// Directions that the rays of a scan cover: azimuths between neighbouring rays, and an
/// interval of elevations for each sector of azimuth.
class FieldOfView {
public:
    explicit FieldOfView(const RenderedScan& scan) {
        intervals_.fill({2.0, -2.0});  // empty
        for (const glm::vec3& direction : scan.image.direction) {
            azimuths_.push_back(azimuth_of(glm::dvec3(direction)));
            ElevationInterval& interval = intervals_[sector_of(azimuths_.back())];
            interval.lowest_sine = std::min(interval.lowest_sine, double(direction.z));
            interval.highest_sine = std::max(interval.highest_sine, double(direction.z));
        }
        std::ranges::sort(azimuths_);
        // Closes the circle, so that every azimuth is between two neighbours.
        if (!azimuths_.empty()) azimuths_.push_back(azimuths_.front() + 2.0 * kPi);
    }
    bool contains_point(const glm::dvec3& point_m) const {
        constexpr double kMaxGap_rad = 3.0 * kPi / 180.0;  // wider than the columns of all sensors
        if (azimuths_.empty()) return false;
        double azimuth = azimuth_of(point_m);
        if (azimuth < azimuths_.front()) azimuth += 2.0 * kPi;
        const auto next = std::ranges::upper_bound(azimuths_, azimuth);  // not the first
        if (next == azimuths_.end() || *next - *std::prev(next) > kMaxGap_rad) return false;
        const ElevationInterval& interval = intervals_[sector_of(azimuth)];
        const double sine = point_m.z / glm::length(point_m);
        return sine >= interval.lowest_sine && sine <= interval.highest_sine;
    }

private:
    struct ElevationInterval {
        double lowest_sine, highest_sine;
    };
    std::vector<double> azimuths_;                 ///< of all rays, ascending; the first again after a turn
    std::array<ElevationInterval, 90> intervals_;  // sectors of 4 degrees

    static double azimuth_of(const glm::dvec3& v) { return std::atan2(v.y, v.x); }
    std::size_t sector_of(double azimuth_rad) const {
        const double turn = 0.5 + azimuth_rad / (2.0 * kPi);
        return std::size_t(turn * double(intervals_.size())) % intervals_.size();
    }
};

/// Returns the share of a box that is in no field of view.
/// @param sensor_from_box  [sensors]
double share_outside(const std::vector<FieldOfView>& views, const std::vector<Pose>& sensor_from_box,
                     const glm::dvec3& size_m) {
    // Tests the centres of equal cells of the box.
    constexpr int kSteps = 8;  // cells along each axis
    int n_outside = 0;
    for (int i = 0; i < kSteps * kSteps * kSteps; ++i) {
        const glm::dvec3 cell(i % kSteps, i / kSteps % kSteps, i / (kSteps * kSteps));
        const glm::dvec3 point = ((cell + 0.5) / double(kSteps) - 0.5) * size_m;
        bool is_inside = false;
        for (std::size_t s = 0; s < views.size() && !is_inside; ++s)
            is_inside = views[s].contains_point(sensor_from_box[s] * point);
        if (!is_inside) ++n_outside;
    }
    return double(n_outside) / (kSteps * kSteps * kSteps);
}

LabelledObject describe_object(const scan_files::ActorInScan& actor, int number, std::size_t n_points) {
    const BoxTrack& box = *actor.box;
    return {.track = box.id,
            .category = label_of(box),
            .object_class = class_of(box),
            .number = number,
            .is_static = actor.is_static,
            .moves = box.is_moving(),
            .size_m = box.size_m,
            .world_from_box = actor.world_from_box(actor.faced_s),
            .n_points = n_points,
            .visible_share = actor.visible_share};
}

/// Returns the objects that at least one sensor hits, in the order of their tracks. If
/// several sensors hit an object, its box is the one of the sensor with most points,
/// which it fits best. The visible share is that of the sensor that sees most.
std::vector<LabelledObject> find_seen_objects(std::span<const RenderedScan> scans,
                                              const std::vector<DatasetSensor>& sensors) {
    const ScanOutputOptions& options = sensors.front().options;
    std::vector<std::string> tracks;
    for (const auto* boxes : {&options.actors, &options.standing})
        for (const BoxTrack& box : *boxes) tracks.push_back(box.id);
    std::map<int, scan_files::ActorInScan> seen;  // by the index of the track
    std::map<int, std::size_t> n_points;          // of all sensors
    for (std::size_t s = 0; s < scans.size(); ++s)
        for (const scan_files::ActorInScan& actor : scan_files::find_actors(scans[s], sensors[s].options)) {
            // An actor with a note is not visible: its points belong to another object.
            if (actor.n_points == 0 || actor.note != LabelNote::none) continue;
            const int number = int(std::ranges::find(tracks, actor.box->id) - tracks.begin());
            scan_files::ActorInScan& best = seen.try_emplace(number, actor).first->second;
            n_points[number] += actor.n_points;
            const auto largest_share = std::max(actor.visible_share, best.visible_share);
            if (actor.n_points > best.n_points) best = actor;
            best.visible_share = largest_share;
        }
    std::vector<LabelledObject> objects;
    for (const auto& [number, actor] : seen)
        objects.push_back(describe_object(actor, number, n_points[number]));
    return objects;
}

}  // namespace

ObjectNames find_object_names(const std::string& category) {
    std::string word = category;
    std::ranges::transform(word, word.begin(), [](unsigned char c) { return char(std::tolower(c)); });
    for (const NamesOfWord& row : kNamesOfWords)
        if (word.find(row.word) != std::string::npos) return row.names;
    return kNamesOfKinds[std::size_t(parse_kind(category))];
}

std::string nuscenes_category(const std::string& category) {
    return category.find('.') == std::string::npos ? find_object_names(category).nuscenes : category;
}

/// Returns the points of all sensors at one time, and the labelled boxes of the objects
/// that at least one point shows.
/// @param index index of the frame in its sequence
LabelledFrame label_frame(std::span<const RenderedScan> scans, const std::vector<DatasetSensor>& sensors,
                          std::size_t index) {
    LabelledFrame frame{.index = index, .time_s = scans[0].time_s};
    frame.stamp_ns = scan_files::to_stamp_ns(frame.time_s, sensors[0].options.time_shift_ns);
    // The rig's pose at the reference time of the first sensor's scan.
    frame.world_from_rig = scans[0].world_from_sensor * inverse(sensors[0].rig_from_sensor);
    std::vector<FieldOfView> views;
    for (std::size_t s = 0; s < scans.size(); ++s) {
        views.emplace_back(scans[s]);
        frame.n_rings.push_back(scans[s].ring.empty() ? 0 : 1 + *std::ranges::max_element(scans[s].ring));
        frame.clouds.push_back(place_points(scans[s], sensors[s].options.config, scans[s].world_from_sensor));
    }
    for (LabelledObject& object : find_seen_objects(scans, sensors)) {
        std::vector<Pose> sensor_from_box;
        for (const RenderedScan& scan : scans)
            sensor_from_box.push_back(inverse(scan.world_from_sensor) * object.world_from_box);
        object.truncated = share_outside(views, sensor_from_box, object.size_m);
        frame.objects.push_back(std::move(object));
    }
    return frame;
}

}  // namespace relidar::layouts
