// SPDX-License-Identifier: Apache-2.0
// A store NAME.ncore4.zarr.itar, or NAME.ncore4-GROUP.zarr.itar, has the groups
// KIND/INSTANCE of components. Stores of the same NAME and folder are one sequence.
#include "read/datasets/ncore/ncore_sequence.hpp"

#include <algorithm>
#include <deque>
#include <map>
#include <utility>

#include <fmt/ranges.h>

#include <relidar/read/clouds.hpp>

#include "base/fail.hpp"
#include "base/files.hpp"

namespace relidar::ncore {
namespace {

namespace fs = std::filesystem;

constexpr const char* kArchiveEnding = ".zarr.itar";
constexpr const char* kFolderEnding = ".zarr";
constexpr std::size_t kLongestName = 200;
constexpr std::int64_t kLatestTime_us = 4'000'000'000'000'000;  // in the year 2096
constexpr std::size_t kPoseNumbers = 16;
constexpr std::size_t kMostEdges = 200;
constexpr double kSameTime_s = 1e-3;  // tolerance of the first and last time of a trajectory

/// Returns the name of the sequence in the name of a store, or nothing for other files.
std::optional<std::string> sequence_name(const fs::path& path) {
    std::string name = path.filename().string();
    if (!name.ends_with(fs::is_directory(path) ? kFolderEnding : kArchiveEnding)) return std::nullopt;
    name.erase(name.rfind(kFolderEnding));
    return name.substr(0, name.rfind(".ncore4"));
}

/// Returns the files or folders (stores) of one sequence. The stores of a sequence are in
/// one folder and have equal names up to ".ncore4".
/// @param path  one of the stores, or a folder with a single sequence
std::vector<fs::path> find_stores(const fs::path& path) {
    // Keeps the name of a link, because the file that it names can have any name.
    fs::path full = fs::absolute(path).lexically_normal();
    if (!full.has_filename()) full = full.parent_path();
    const std::optional<std::string> requested = sequence_name(full);  // no value for a folder of stores
    // A folder can have the same sequence twice: as files and as folders. If `path` is a
    // store, only stores of its form are used.
    const auto is_requested = [&](const fs::path& entry) {
        return !requested ||
               (sequence_name(entry) == requested && fs::is_directory(entry) == fs::is_directory(full));
    };
    std::vector<fs::path> stores;
    for (const fs::path& entry : list_folder(requested ? full.parent_path() : full)) {
        const std::optional<std::string> name = sequence_name(entry);
        if (!name || !is_requested(entry)) continue;
        if (!stores.empty() && name != sequence_name(stores[0]))
            fail("{} has the sequences {} and {}; select one of its files", path.string(),
                 quote(*sequence_name(stores[0])), quote(*name));
        stores.push_back(entry);
    }
    if (stores.empty()) fail("{} contains no store of NCore, expected *{}", path.string(), kArchiveEnding);
    std::ranges::sort(stores);
    return stores;
}

/// Splits a key "('source', 'target')", the text of a Python tuple, into both names. A
/// name has double quotes if it contains a single quote.
std::pair<std::string, std::string> split_edge(const std::string& key, const std::string& where) {
    std::vector<std::string> names;
    std::size_t opening = 1;  // position of the quote before a name
    while (opening < key.size() && names.size() < 2) {
        const char mark = key[opening];
        const std::size_t closing = key.find(mark, opening + 1);
        if ((mark != '\'' && mark != '"') || closing == std::string::npos) break;
        names.push_back(key.substr(opening + 1, closing - opening - 1));
        opening = closing + 3;  // skips the quote, a comma and a blank
    }
    if (names.size() != 2 || key.front() != '(' || key.back() != ')')
        fail("{}: the edge is '{}', expected ('source', 'target')", where, quote(key));
    return {names[0], names[1]};
}

/// Reads the poses that join two coordinate frames, without the names of the frames. A
/// fixed edge has one matrix "pose", which gets the time 0. A moving edge has matrices
/// "poses" with times.
PoseGraph::Edge read_edge(const JsonField& field, const NcoreSequence& sequence) {
    PoseGraph::Edge edge;
    edge.is_fixed = field.has_member("pose");
    const JsonField poses = field.at(edge.is_fixed ? "pose" : "poses");
    const std::vector<double> numbers = poses.flat_numbers(3);
    std::vector<double> times_s;
    if (edge.is_fixed) {
        times_s = {0.0};
    } else {
        const JsonField stamps = field.at("timestamps_us");
        for (std::size_t i = 0; i < stamps.size(); ++i)
            times_s.push_back(sequence.seconds_of(read_time_us(stamps.at(i))));
    }
    if (times_s.empty() || numbers.size() != kPoseNumbers * times_s.size())
        poses.reject(fmt::format("found {} numbers for {} times", numbers.size(), times_s.size()),
                     fmt::format("expected {} numbers for each time", kPoseNumbers));
    for (std::size_t i = 0; i < times_s.size(); ++i) {
        if (i > 0 && !(times_s[i] > times_s[i - 1]))
            field.at("timestamps_us").at(i).reject("found no later time", "expected increasing times");
        const auto matrix = std::span(numbers).subspan(kPoseNumbers * i, kPoseNumbers);
        edge.track.append(times_s[i], make_pose(matrix, poses.at(edge.is_fixed ? 0 : i).location()));
    }
    return edge;
}

/// Returns the kinds of components in a store that are not read, each with the names of
/// its instances.
std::vector<std::string> list_unread(const ZarrStore& store) {
    std::vector<std::string> unread;
    for (const std::string& kind : store.list_children(""))
        if (kind != "poses" && kind != "intrinsics" && kind != "lidars" && kind != "cuboids")
            unread.push_back(fmt::format("{} ({})", quote(kind), fmt::join(store.list_children(kind), ", ")));
    return unread;
}

/// Adds a note with the free text that the creator of a sequence has stored, if any.
void note_meta_data(Notes& notes, const ZarrJson& attributes) {
    constexpr const char* kKey = "generic_meta_data";
    if (!attributes.root().has_member(kKey) || attributes.json[kKey].empty()) return;
    // `replace` prevents an exception if the text is not valid UTF-8.
    const std::string text =
        attributes.json[kKey].dump(-1, ' ', true, nlohmann::json::error_handler_t::replace);
    notes.push_back("meta data of the sequence: " + quote(text));
}

}  // namespace

std::int64_t read_time_us(const JsonField& field) { return field.integer_in(0, kLatestTime_us); }

/// Opens all stores of a sequence and checks that they belong together. Adds notes about
/// components that are not read. Each store has the id and the start of the sequence.
NcoreSequence::NcoreSequence(const fs::path& path) {
    for (const fs::path& store : find_stores(path)) stores_.emplace_back(store);
    std::vector<std::string> unread;
    for (const ZarrStore& store : stores_) {
        const ZarrJson attributes = read_zarr_attributes(store, "");
        const JsonField root = attributes.root();
        if (const std::string version = root.at("version").short_text(kLongestName); version != "v4")
            fail("{}: the version is '{}', expected v4 of NCore", store.name(), quote(version));
        const std::string name = root.at("sequence_id").short_text(kLongestName);
        if (!id.empty() && name != id)
            fail("{}: the sequence is '{}', expected '{}' as in the other stores", store.name(), quote(name),
                 quote(id));
        id = name;
        start_us = read_time_us(root.at("sequence_timestamp_interval_us").at("start"));
        std::ranges::copy(list_unread(store), std::back_inserter(unread));
        // Only the text of the first store is shown.
        if (&store == &stores_.front()) note_meta_data(notes, attributes);
    }
    if (!unread.empty())
        notes.push_back(fmt::format("these components are not read: {}", fmt::join(unread, ", ")));
}

std::vector<Component> NcoreSequence::list_components(const std::string& kind) const {
    std::vector<Component> components;
    for (const ZarrStore& store : stores_)
        for (const std::string& name : store.list_children(kind))
            components.push_back({&store, kind + "/" + name, name});
    std::ranges::stable_sort(components, {}, [](const Component& component) {
        return std::pair(component.name != "default", component.name);
    });
    for (std::size_t i = 1; i < components.size(); ++i)
        if (components[i].name == components[i - 1].name)
            fail("{}: {} is also in {}, expected it once", components[i].store->name(), components[i].path,
                 components[i - 1].store->name());
    return components;
}

PoseGraph::PoseGraph(const NcoreSequence& sequence, Notes& notes) {
    for (const Component& component : sequence.list_components("poses")) {
        std::size_t n_repeated = 0;
        for (const char* group : {"static_poses", "dynamic_poses"}) {
            const ZarrJson attributes = component.attributes(group);
            for (const auto& [key, value] : attributes.json.items()) {
                auto [source, target] = split_edge(key, attributes.where);
                // The graph stays a tree, so that only one path joins two frames.
                if (find_path(source, target)) {
                    ++n_repeated;
                    continue;
                }
                Edge edge = read_edge(attributes.root().at(key), sequence);
                edge.source = std::move(source);
                edge.target = std::move(target);
                edges_.push_back(std::move(edge));
                if (edges_.size() > kMostEdges)
                    fail("{}: found more than {} edges between frames", attributes.where, kMostEdges);
            }
        }
        if (n_repeated > 0)
            notes.push_back(fmt::format("{} poses of {} are ignored, because other poses join their frames",
                                        n_repeated, component.path));
    }
}

bool PoseGraph::has_frame(const std::string& name) const {
    return std::ranges::any_of(edges_,
                               [&](const Edge& edge) { return edge.source == name || edge.target == name; });
}

std::optional<PoseGraph::Path> PoseGraph::find_path(const std::string& source,
                                                    const std::string& target) const {
    // breadth-first search
    std::map<std::string, Path> path_to{{source, {}}};  // path from `source` to each reached frame
    std::deque<std::string> queue{source};              // reached frames whose edges were not followed yet
    for (; !queue.empty(); queue.pop_front()) {
        const std::string frame = queue.front();
        if (frame == target) return path_to[target];
        for (const Edge& edge : edges_)
            for (const bool is_reverse : {false, true}) {
                const Step step{&edge, is_reverse};  // leads from step.begin() to `next`
                const std::string& next = is_reverse ? edge.source : edge.target;
                if (step.begin() != frame || path_to.contains(next)) continue;
                Path path = path_to[frame];
                path.push_back(step);
                path_to[next] = std::move(path);
                queue.push_back(next);
            }
    }
    return std::nullopt;
}

bool PoseGraph::is_fixed(const Path& path) {
    return std::ranges::all_of(path, [](const Step& step) { return step.edge->is_fixed; });
}

bool PoseGraph::is_known(const Path& path, double time_s) {
    return std::ranges::all_of(path, [&](const Step& step) {
        const std::vector<double>& times_s = step.edge->track.time_s;
        return step.edge->is_fixed ||
               (time_s >= times_s.front() - kSameTime_s && time_s <= times_s.back() + kSameTime_s);
    });
}

Pose PoseGraph::pose_at(const Path& path, double time_s) {
    Pose pose;
    for (const Step& step : path) {
        const Pose target_from_source = step.edge->track.pose_at(time_s);
        pose = (step.is_reverse ? inverse(target_from_source) : target_from_source) * pose;
    }
    return pose;
}

}  // namespace relidar::ncore
