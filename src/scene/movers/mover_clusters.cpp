// SPDX-License-Identifier: Apache-2.0
// Decides which returns of a frame moved, and groups them into clusters.
#include "scene/movers/mover_tracks.hpp"

#include <iterator>

#include "base/geometry/cell_key.hpp"
#include "base/geometry/cell_numbers.hpp"
#include "base/parallel.hpp"

namespace relidar {
namespace {

constexpr double kMaxRange_m = 40.0;     // beyond this range, a person has only one or two returns
constexpr double kEvidenceCell_m = 0.2;  // the returns of a cell of this size move or rest together
constexpr double kClusterSquare_m = 0.3;
// Returns belong to one object if their squares are at most this far apart in x and y.
constexpr int kReach_squares = 2;
constexpr double kMinPoints = 12;  // minimum number of moved returns in a cluster
constexpr double kMaxLength_m = 14.0;
// Minimum ratio (frames that find a cell empty) / (frames with a return in it) of a moved
// cell. The threshold is low, because a vehicle often hides empty cells behind it.
constexpr double kMinEmptyShare = 0.25;
constexpr int kTooFewFrames = 3;         // A static object is usually visible in more frames than this
constexpr double kGroundBelow_m = 0.05;  // points farther below the lowest moved point are ground
// Vertical gap that separates two objects. At 29 m, beams that are two degrees apart
// leave a gap of this size.
constexpr double kGapAbove_m = 1.0;
constexpr double kMovedShare = 0.15;  // minimum share of moved returns in a cluster
// Minimum number of consecutive frames in a section. Cells at the border between two
// sections are computed twice.
constexpr std::size_t kFramesPerSection = 200;

/// `moved`: other frames find the cell empty. `rarely_observed`: too few frames observe
/// the cell. It becomes part of an object only if it is next to a `moved` cell.
enum class CellMotionState : char { rests, rarely_observed, moved };

struct MoverReturn {
    glm::vec3 point_m;
    double time_s;
    std::uint32_t cell = 0;  ///< index of the grid cell, see assign_cells()
    CellMotionState motion = CellMotionState::rests;
};

struct LabelledBox {
    BoxTrack box;
    int label;  ///< kNoLabel if the box is static
};

/// Returns the labelled boxes at a given time: a moving box only during the time of its
/// labels, a static box at all times, because the object was probably parked there.
std::vector<LabelledBox> labelled_boxes_at(const Log& log, double time_s) {
    std::vector<LabelledBox> boxes;
    for (std::size_t i = 0; i < log.boxes.size(); ++i) {
        const BoxTrack& box = log.boxes[i];
        const PoseTrack& track = box.world_from_box;
        if (track.pose.empty()) continue;
        if (box.is_moving()) {
            if (box.is_observed(time_s)) boxes.push_back({box, static_cast<int>(i)});
            continue;
        }
        BoxTrack& parked = boxes.emplace_back(LabelledBox{box, kNoLabel}).box;
        parked.world_from_box = {
            {time_s}, {track.pose_at(std::clamp(time_s, track.time_s.front(), track.time_s.back()))}};
    }
    return boxes;
}

/// LiDAR returns of one frame within 40 m: `others` outside all labelled boxes, and one
/// cluster in each moving labelled box. Leaves out returns in static labelled boxes.
struct FrameMoverReturns {
    std::vector<MoverReturn> others;
    std::vector<MoverCluster> of_labels;
};

/// Adds a return to a cluster, whose time and centre are sums until mean_of_sums().
void add_to_sums(MoverCluster& sums, const glm::dvec3& point_m, double time_s) {
    sums.time_s += time_s;
    sums.centre_m += point_m;
    sums.points_m.push_back(point_m);
}

MoverCluster mean_of_sums(MoverCluster sums) {
    sums.time_s /= double(sums.points_m.size());
    sums.centre_m /= double(sums.points_m.size());
    return sums;
}

/// Separates the returns of a frame into returns in the labelled boxes that move, in
/// those that stand, and outside all labelled boxes.
FrameMoverReturns split_by_boxes(const Log& log, const Frame& frame) {
    const std::vector<LabelledBox> labelled = labelled_boxes_at(log, frame.time_s);
    std::vector<MoverCluster> sums_in_boxes(labelled.size());
    FrameMoverReturns result;
    for (std::size_t ray = 0; ray < frame.scan.range_m.size(); ++ray) {
        if (!(frame.scan.range_m[ray] > 0.0f && frame.scan.range_m[ray] < kMaxRange_m)) continue;
        const WorldReturn hit = locate_return(log, frame, ray);
        const auto match = std::ranges::find_if(labelled, [&](const LabelledBox& candidate) {
            return candidate.box.contains_point(hit.point_m, hit.time_s, kMoverMargin_m);
        });
        if (match == labelled.end()) {
            result.others.push_back({.point_m = glm::vec3(hit.point_m), .time_s = hit.time_s});
            continue;
        }
        // Returns in the margin belong to no cluster, because the margin contains ground.
        const bool is_moving_box = match->label != kNoLabel;
        if (!is_moving_box || !match->box.contains_point(hit.point_m, hit.time_s, 0.0)) continue;
        MoverCluster& sums = sums_in_boxes[std::size_t(match - labelled.begin())];
        sums.label = match->label;
        add_to_sums(sums, hit.point_m, hit.time_s);
    }
    for (MoverCluster& cluster : sums_in_boxes)
        if (!cluster.points_m.empty()) result.of_labels.push_back(mean_of_sums(std::move(cluster)));
    return result;
}

/// Sets the cell of each return in a world grid. The occupied cells are numbered from 0.
/// @return [cells] mean position of the returns in each cell
std::vector<glm::vec3> assign_cells(std::vector<FrameMoverReturns>& frames) {
    std::vector<MoverReturn*> all;
    for (FrameMoverReturns& frame : frames)
        for (MoverReturn& r : frame.others) all.push_back(&r);
    const ItemCellIndices cells = number_cells(all.size(), [&](std::size_t index) {
        return grid_key(glm::dvec3(all[index]->point_m), kEvidenceCell_m);
    });
    parallel_blocks(all.size(), [&](std::size_t index) { all[index]->cell = cells.of[index]; });
    const CellItemLists returns_by_cell(cells);
    std::vector<glm::vec3> means(returns_by_cell.size());
    parallel_blocks(means.size(), [&](std::size_t cell) {
        const auto& returns = returns_by_cell.items_of(cell);
        glm::dvec3 sum(0.0);
        for (const std::uint32_t i : returns) sum += glm::dvec3(all[i]->point_m);
        means[cell] = glm::vec3(sum / double(returns.size()));
    });
    return means;
}

/// Returns the lower and the upper limit of an object above the ground. Splits the
/// heights of its moved returns at large gaps, for example between a car and a tree above
/// it. Uses the part with the most heights, and adds a margin.
std::pair<double, double> find_height_range(std::vector<double> heights_m) {
    std::sort(heights_m.begin(), heights_m.end());
    // A part is a range [first, end) of the sorted heights.
    std::size_t first = 0, largest_first = 0, largest_end = 0;
    for (std::size_t end = 1; end <= heights_m.size(); ++end) {
        const bool is_split = end == heights_m.size() || heights_m[end] - heights_m[end - 1] >= kGapAbove_m;
        if (!is_split) continue;
        if (end - first > largest_end - largest_first) {
            largest_first = first;
            largest_end = end;
        }
        first = end;
    }
    return {heights_m[largest_first] - kGroundBelow_m, heights_m[largest_end - 1] + kGapAbove_m};
}

/// Returns the key of the square of the ground below a point.
std::uint64_t key_of_square(const glm::dvec3& point_m) {
    return grid_key({point_m.x, point_m.y, 0.0}, kClusterSquare_m);
}

using ReturnsBySquare = std::unordered_map<std::uint64_t, std::vector<std::uint32_t>>;

/// Appends the returns in the squares around a point to `group`, unless they have a group
/// already. Empties these squares, because all their returns then have a group.
void append_neighbours(const glm::dvec3& point_m, ReturnsBySquare& squares, std::vector<char>& is_grouped,
                       std::vector<std::uint32_t>& group) {
    for (int dx = -kReach_squares; dx <= kReach_squares; ++dx)
        for (int dy = -kReach_squares; dy <= kReach_squares; ++dy) {
            const glm::dvec3 offset_m = kClusterSquare_m * glm::dvec3(dx, dy, 0.0);
            const auto square = squares.find(key_of_square(point_m + offset_m));
            if (square == squares.end()) continue;
            for (const std::uint32_t i : square->second) {
                if (!is_grouped[i]) group.push_back(i);
                is_grouped[i] = 1;
            }
            square->second.clear();
        }
}

/// Groups returns that are close to each other in the view from above. A group contains
/// all moved returns that a chain of neighbours connects, and the returns with unknown
/// motion next to them.
/// @return [groups] indices of the returns
std::vector<std::vector<std::uint32_t>> group_returns(const std::vector<MoverReturn>& returns) {
    ReturnsBySquare squares;
    for (std::uint32_t i = 0; i < returns.size(); ++i)
        squares[key_of_square(glm::dvec3(returns[i].point_m))].push_back(i);
    std::vector<std::vector<std::uint32_t>> groups;
    std::vector<char> is_grouped(returns.size(), 0);
    for (std::uint32_t start = 0; start < returns.size(); ++start) {
        if (is_grouped[start] || returns[start].motion != CellMotionState::moved) continue;
        std::vector<std::uint32_t>& group = groups.emplace_back();
        std::vector<std::uint32_t> open{start};  // members whose neighbours are not added yet
        is_grouped[start] = 1;
        while (!open.empty()) {
            const std::uint32_t member = open.back();
            open.pop_back();
            group.push_back(member);
            // Only moved returns extend a group.
            if (returns[member].motion != CellMotionState::moved) continue;
            append_neighbours(glm::dvec3(returns[member].point_m), squares, is_grouped, open);
        }
    }
    return groups;
}

/// Makes a cluster of a group of returns. Leaves out returns below and above the object.
/// @return nothing if too few of the other returns moved, or if they are too far apart
std::optional<MoverCluster> make_cluster(const std::vector<MoverReturn>& returns,
                                         const std::vector<std::uint32_t>& group) {
    std::vector<double> moved_heights_m;
    for (const std::uint32_t i : group)
        if (returns[i].motion == CellMotionState::moved)
            moved_heights_m.push_back(double(returns[i].point_m.z));
    const auto [bottom_m, top_m] = find_height_range(std::move(moved_heights_m));
    MoverCluster sums;
    glm::dvec3 low(1e30), high(-1e30);  // corners of the bounding box
    double n_moved = 0.0;
    for (const std::uint32_t i : group) {
        const glm::dvec3 p(returns[i].point_m);
        if (p.z < bottom_m || p.z > top_m) continue;
        if (returns[i].motion == CellMotionState::moved) ++n_moved;
        add_to_sums(sums, p, returns[i].time_s);
        low = glm::min(low, p);
        high = glm::max(high, p);
    }
    const bool has_moved = n_moved >= kMinPoints && n_moved >= kMovedShare * double(sums.points_m.size());
    const bool is_too_long = glm::length(glm::dvec2(high - low)) >= kMaxLength_m;
    if (!has_moved || is_too_long) return std::nullopt;
    return mean_of_sums(std::move(sums));
}

/// Returns the clusters of the moved returns of one frame.
std::vector<MoverCluster> cluster_returns(const std::vector<MoverReturn>& returns) {
    std::vector<MoverCluster> clusters;
    for (const std::vector<std::uint32_t>& group : group_returns(returns)) {
        std::optional<MoverCluster> cluster = make_cluster(returns, group);
        if (cluster) clusters.push_back(std::move(*cluster));
    }
    return clusters;
}

/// Returns the clusters of points on moving objects in consecutive frames. Decides once
/// per grid cell whether its returns moved, because frames share most cells.
ClustersByFrame cluster_frames(const Log& log, std::span<const int> indices, VisibilityChecker& view) {
    std::vector<FrameMoverReturns> frames(indices.size());
    parallel_for(static_cast<int>(indices.size()), [&](int index) {
        const auto position = std::size_t(indices[std::size_t(index)]);
        frames[std::size_t(index)] = split_by_boxes(log, log.frames[position]);
    });
    // All frames vote whether the returns of a cell moved.
    const std::vector<glm::vec3> cell_points = assign_cells(frames);  // sets MoverReturn::cell
    view.make_images(cell_points);
    std::vector<CellMotionState> motion(cell_points.size());
    parallel_blocks(motion.size(), [&](std::size_t cell) {
        const VisibilityChecker::VisibilityVotes votes = view.count_votes(cell_points[cell]);
        if (votes.is_empty_space(kMinEmptyShare)) motion[cell] = CellMotionState::moved;
        else if (votes.n_occupied <= kTooFewFrames) motion[cell] = CellMotionState::rarely_observed;
        else motion[cell] = CellMotionState::rests;
    });
    // Clusters the moved returns outside labelled boxes. Adds the clusters inside them.
    ClustersByFrame clusters(frames.size());
    parallel_for(static_cast<int>(frames.size()), [&](int index) {
        FrameMoverReturns& frame = frames[std::size_t(index)];
        for (MoverReturn& r : frame.others) r.motion = motion[r.cell];
        std::erase_if(frame.others, [](const MoverReturn& r) { return r.motion == CellMotionState::rests; });
        clusters[std::size_t(index)] = cluster_returns(frame.others);
        std::ranges::move(frame.of_labels, std::back_inserter(clusters[std::size_t(index)]));
    });
    return clusters;
}

/// Collects the clusters of consecutive sections of frames from all processes of a group.
ClustersByFrame gather_clusters(const ProcessGroup& group, const ClustersByFrame& local_clusters) {
    if (group.size == 1) return local_clusters;
    struct ClusterRecord {
        double time_s;
        glm::dvec3 centre_m;
        std::uint64_t n_points;
        std::int64_t label;
    };
    // The group exchanges flat arrays. The counts restore the lists per frame.
    std::vector<std::uint64_t> n_clusters;  // [frames]
    std::vector<ClusterRecord> heads;       // [clusters] all except the points
    std::vector<glm::dvec3> points;         // of all clusters
    for (const std::vector<MoverCluster>& frame : local_clusters) {
        n_clusters.push_back(frame.size());
        for (const MoverCluster& cluster : frame) {
            heads.push_back({cluster.time_s, cluster.centre_m, cluster.points_m.size(), cluster.label});
            points.insert(points.end(), cluster.points_m.begin(), cluster.points_m.end());
        }
    }
    n_clusters = group.gather(std::move(n_clusters));
    heads = group.gather(std::move(heads));
    points = group.gather(std::move(points));
    ClustersByFrame all;
    auto head = heads.begin();
    auto point = points.begin();
    for (const std::uint64_t n : n_clusters) {
        std::vector<MoverCluster>& frame = all.emplace_back();
        for (std::uint64_t i = 0; i < n; ++i, ++head) {
            const auto end = point + std::ptrdiff_t(head->n_points);
            frame.push_back({head->time_s, head->centre_m, {point, end}, static_cast<int>(head->label)});
            point = end;
        }
    }
    return all;
}

}  // namespace

void MoverCluster::merge_cluster(const MoverCluster& other) {
    const double n = double(points_m.size()), m = double(other.points_m.size());
    time_s = (n * time_s + m * other.time_s) / (n + m);
    centre_m = (n * centre_m + m * other.centre_m) / (n + m);
    points_m.insert(points_m.end(), other.points_m.begin(), other.points_m.end());
}

ClustersByFrame find_clusters(const Log& log, const std::vector<int>& frames, VisibilityChecker& view,
                              const Progress& progress, const ProcessGroup& group) {
    // The sections, and so the results, do not depend on the number of processes.
    const std::size_t n_sections = std::max<std::size_t>(1, frames.size() / kFramesPerSection);
    const auto begin_of = [&](std::size_t section) { return frames.size() * section / n_sections; };
    const ProcessGroup::PartRange local_sections = group.part_range(n_sections);
    ClustersByFrame clusters;
    for (std::size_t s = local_sections.begin; s < local_sections.end; ++s) {
        const auto n_done = double(s - local_sections.begin),
                   n_local = double(local_sections.end - local_sections.begin);
        if (progress) progress("finding moving objects", n_done / n_local);
        const std::span<const int> section(frames.begin() + std::ptrdiff_t(begin_of(s)),
                                           frames.begin() + std::ptrdiff_t(begin_of(s + 1)));
        ClustersByFrame of_section = cluster_frames(log, section, view);
        std::ranges::move(of_section, std::back_inserter(clusters));
    }
    return gather_clusters(group, clusters);
}

}  // namespace relidar
