// SPDX-License-Identifier: Apache-2.0
// Decides which returns of a frame belong to moving objects. Groups these returns into
// clusters.
#include "scene/movers/mover_tracks.hpp"

#include <iterator>

#include "base/geometry/cell_key.hpp"
#include "base/geometry/cell_numbers.hpp"
#include "base/parallel.hpp"

namespace relidar {
namespace {

constexpr double kMaxRange_m = 40.0;  // beyond this range, a person has only one or two returns
// Edge length of the cells for which the program decides whether their returns moved.
constexpr double kEvidenceCell_m = 0.2;
constexpr double kClusterSquare_m = 0.3;
// Two returns belong to the same object if their squares are at most this many squares
// apart along x and along y.
constexpr int kReach_squares = 2;
constexpr double kMinPoints = 12;  // minimum number of moved returns in a cluster
constexpr double kMaxLength_m = 14.0;
// Minimum ratio (frames that find a cell empty) / (frames with a return in it) of a moved
// cell. The threshold is low, because a vehicle often hides empty cells behind it.
constexpr double kMinEmptyShare = 0.25;
// A static object is usually visible in more frames than this.
constexpr int kTooFewFrames = 3;
// Points farther below the lowest moved point of a cluster belong to the ground.
constexpr double kGroundBelow_m = 0.05;
// Vertical gap that separates two objects. At 29 m, beams that are two degrees apart
// leave a gap of this size.
constexpr double kGapAbove_m = 1.0;
constexpr double kMovedShare = 0.15;  // minimum share of moved returns in a cluster
// Minimum number of consecutive frames in a group. Cells at the border between two groups
// are computed twice.
constexpr std::size_t kFramesPerGroup = 200;

/// `moved`: other frames find the cell empty. `rarely_observed`: too few frames observe
/// the cell. It becomes part of an object only if it is next to a `moved` cell.
enum class CellMotionState : char { rests, rarely_observed, moved };

struct MoverReturn {
    glm::vec3 point_m;
    double time_s;
    std::uint32_t cell;
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
        BoxTrack& still = boxes.emplace_back(LabelledBox{box, kNoLabel}).box;
        still.world_from_box = {
            {time_s}, {track.pose_at(std::clamp(time_s, track.time_s.front(), track.time_s.back()))}};
    }
    return boxes;
}

/// LiDAR returns of one frame within 40 m. `others` are the returns outside all labelled
/// boxes. `of_labels` has one cluster of returns for each moving labelled box. Returns in
/// static labelled boxes are left out.
struct FrameMoverReturns {
    std::vector<MoverReturn> others;
    std::vector<MoverCluster> of_labels;
};

/// Converts sums over the points of a cluster, time and centre, to means.
MoverCluster mean_of_sums(MoverCluster sums) {
    sums.time_s /= double(sums.points_m.size());
    sums.centre_m /= double(sums.points_m.size());
    return sums;
}

/// Separates the returns of a frame into returns inside moving labelled boxes and returns
/// outside all labelled boxes.
FrameMoverReturns split_by_boxes(const Log& log, const Frame& frame) {
    const std::vector<LabelledBox> labelled = labelled_boxes_at(log, frame.time_s);
    std::vector<MoverCluster> of_boxes(labelled.size());
    FrameMoverReturns result;
    for (std::size_t ray = 0; ray < frame.scan.range_m.size(); ++ray) {
        if (!(frame.scan.range_m[ray] > 0.0f && frame.scan.range_m[ray] < kMaxRange_m)) continue;
        const WorldReturn w = locate_return(log, frame, ray);
        const auto in = std::ranges::find_if(labelled, [&](const LabelledBox& l) {
            return l.box.contains_point(w.point_m, w.time_s, kMoverMargin_m);
        });
        if (in == labelled.end()) {
            result.others.push_back({glm::vec3(w.point_m), w.time_s, 0, CellMotionState::rests});
            // The margin would contain points of the ground.
        } else if (in->label != kNoLabel && in->box.contains_point(w.point_m, w.time_s, 0.0)) {
            MoverCluster& cluster = of_boxes[std::size_t(in - labelled.begin())];
            cluster.label = in->label;
            cluster.time_s += w.time_s;
            cluster.centre_m += w.point_m;
            cluster.points_m.push_back(w.point_m);
        }
    }
    for (MoverCluster& cluster : of_boxes)
        if (!cluster.points_m.empty()) result.of_labels.push_back(mean_of_sums(std::move(cluster)));
    return result;
}

/// Assigns each return to a cell of a world grid.
/// @return [cells] mean position of the returns in each cell
std::vector<glm::vec3> assign_cells(std::vector<FrameMoverReturns>& frames) {
    std::vector<MoverReturn*> all;
    for (FrameMoverReturns& frame : frames)
        for (MoverReturn& r : frame.others) all.push_back(&r);
    const ItemCellIndices numbers = number_cells(all.size(), [&](std::size_t index) {
        return grid_key(glm::dvec3(all[index]->point_m), kEvidenceCell_m);
    });
    const CellItemLists items(numbers);
    parallel_blocks(all.size(), [&](std::size_t index) { all[index]->cell = numbers.of[index]; });
    std::vector<glm::vec3> means(items.size());
    parallel_blocks(items.size(), [&](std::size_t cell) {
        glm::dvec3 sum(0.0);
        for (const std::uint32_t i : items.items_of(cell)) sum += glm::dvec3(all[i]->point_m);
        means[cell] = glm::vec3(sum / double(items.items_of(cell).size()));
    });
    return means;
}

/// Returns the lower and the upper limit of an object above the ground. Splits the
/// heights of its moved returns at large gaps, for example between a car and a tree above
/// it. Uses the part with the most heights, and adds a margin.
std::pair<double, double> find_height_range(std::vector<double> heights_m) {
    std::sort(heights_m.begin(), heights_m.end());
    std::size_t best = 0, n_best = 0;
    for (std::size_t first = 0, end; first < heights_m.size(); first = end) {
        for (end = first + 1; end < heights_m.size() && heights_m[end] - heights_m[end - 1] < kGapAbove_m;)
            ++end;
        if (end - first > n_best) {
            best = first;
            n_best = end - first;
        }
    }
    return {heights_m[best] - kGroundBelow_m, heights_m[best + n_best - 1] + kGapAbove_m};
}

/// Groups returns that are close to each other in the view from above. A return whose
/// motion is unknown joins a group only if it is next to a moved return.
std::vector<MoverCluster> cluster_returns(const std::vector<MoverReturn>& returns) {
    std::unordered_map<std::uint64_t, std::vector<std::uint32_t>> squares;
    const auto square_of = [](const glm::dvec3& point) {
        return grid_key({point.x, point.y, 0.0}, kClusterSquare_m);
    };
    for (std::uint32_t i = 0; i < returns.size(); ++i)
        squares[square_of(glm::dvec3(returns[i].point_m))].push_back(i);
    std::vector<char> is_grouped(returns.size(), 0);
    std::vector<MoverCluster> clusters;
    for (std::uint32_t start = 0; start < returns.size(); ++start) {
        if (is_grouped[start] || returns[start].motion != CellMotionState::moved) continue;
        MoverCluster cluster;
        std::vector<std::uint32_t> open{start}, members;
        std::vector<double> moved_at_m;
        is_grouped[start] = 1;
        while (!open.empty()) {
            members.push_back(open.back());
            const MoverReturn& here = returns[open.back()];
            const glm::dvec3 p(here.point_m);
            open.pop_back();
            if (here.motion != CellMotionState::moved) continue;
            moved_at_m.push_back(p.z);
            for (int dx = -kReach_squares; dx <= kReach_squares; ++dx)
                for (int dy = -kReach_squares; dy <= kReach_squares; ++dy) {
                    const auto square =
                        squares.find(square_of(p + kClusterSquare_m * glm::dvec3(dx, dy, 0.0)));
                    if (square == squares.end()) continue;
                    for (const std::uint32_t j : square->second)
                        if (!std::exchange(is_grouped[j], 1)) open.push_back(j);
                    square->second.clear();  // all returns of this square have been added
                }
        }
        const auto [bottom_m, top_m] = find_height_range(std::move(moved_at_m));
        glm::dvec3 low(1e30), high(-1e30);
        double n_moved = 0.0;
        for (const std::uint32_t member : members) {
            const glm::dvec3 p(returns[member].point_m);
            if (p.z < bottom_m || p.z > top_m) continue;
            n_moved += returns[member].motion == CellMotionState::moved;
            cluster.time_s += returns[member].time_s;
            cluster.points_m.push_back(p);
            cluster.centre_m += p;
            low = glm::min(low, p);
            high = glm::max(high, p);
        }
        if (n_moved >= kMinPoints && n_moved >= kMovedShare * double(cluster.points_m.size()) &&
            glm::length(glm::dvec2(high - low)) < kMaxLength_m)
            clusters.push_back(mean_of_sums(std::move(cluster)));
    }
    return clusters;
}

/// Returns the clusters of points on moving objects in consecutive frames. Decides once
/// per grid cell whether its returns moved, because frames share most cells.
ClustersByFrame cluster_frames(const Log& log, std::span<const int> indices, VisibilityChecker& view) {
    std::vector<FrameMoverReturns> frames(indices.size());
    parallel_for(static_cast<int>(indices.size()), [&](int index) {
        frames[std::size_t(index)] =
            split_by_boxes(log, log.frames[std::size_t(indices[std::size_t(index)])]);
    });
    const std::vector<glm::vec3> cells = assign_cells(frames);
    view.make_images(cells);
    std::vector<CellMotionState> motion(cells.size());
    parallel_blocks(cells.size(), [&](std::size_t index) {
        const VisibilityChecker::VisibilityVotes votes = view.count_votes(cells[index]);
        if (votes.is_empty_space(kMinEmptyShare)) motion[index] = CellMotionState::moved;
        else if (votes.n_occupied <= kTooFewFrames) motion[index] = CellMotionState::rarely_observed;
        else motion[index] = CellMotionState::rests;
    });
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
    std::vector<ClusterRecord> heads;
    std::vector<glm::dvec3> points;
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
    // The borders of the stretches do not depend on the number of processes.
    const std::size_t n_stretches = std::max<std::size_t>(1, frames.size() / kFramesPerGroup);
    const auto first_of = [&](std::size_t stretch) { return frames.size() * stretch / n_stretches; };
    const ProcessGroup::PartRange share = group.part_range(n_stretches);
    ClustersByFrame clusters;
    for (std::size_t s = share.begin; s < share.end; ++s) {
        if (progress)
            progress("finding moving objects", double(s - share.begin) / double(share.end - share.begin));
        const std::span<const int> stretch =
            std::span(frames).subspan(first_of(s), first_of(s + 1) - first_of(s));
        ClustersByFrame section = cluster_frames(log, stretch, view);
        std::move(section.begin(), section.end(), std::back_inserter(clusters));
    }
    return gather_clusters(group, clusters);
}

}  // namespace relidar
