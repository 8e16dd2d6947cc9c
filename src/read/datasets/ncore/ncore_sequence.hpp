// SPDX-License-Identifier: Apache-2.0
// The stores of an NCore sequence, and the coordinate frames in them.
#pragma once

#include <cstdint>
#include <filesystem>
#include <optional>
#include <string>
#include <vector>

#include <relidar/log/log.hpp>

#include "base/codecs/zarr.hpp"

namespace relidar::ncore {

/// An instance of a component, for example a LiDAR.
struct Component {
    const ZarrStore* store = nullptr;
    std::string path;  ///< group in the store
    std::string name;  ///< name of the instance

    ZarrJson attributes(const std::string& group = "") const {
        return read_zarr_attributes(*store, group.empty() ? path : path + "/" + group);
    }
};

/// A sequence, which consists of one or several stores.
class NcoreSequence {
public:
    /// Opens all stores of a sequence.
    /// @param path  a store, or a folder of stores
    explicit NcoreSequence(const std::filesystem::path& path);

    std::string id;
    std::int64_t start_us = 0;  ///< time 0 of the log
    Notes notes;

    std::string place() const { return stores_.front().name(); }  ///< for error messages
    /// Returns the instances of a kind of components: "default" first, then by name.
    std::vector<Component> list_components(const std::string& kind) const;
    double seconds_of(std::int64_t time_us) const { return 1e-6 * double(time_us - start_us); }

private:
    std::vector<ZarrStore> stores_;
};

/// A time in the attributes of a store: microseconds.
std::int64_t read_time_us(const JsonField& field);

/// Coordinate frames that are joined by fixed or moving poses.
class PoseGraph {
public:
    /// Reads the edges of all pose components. An edge joins two coordinate frames.
    /// Ignores an edge, with a note, if other edges already join its frames.
    PoseGraph(const NcoreSequence& sequence, Notes& notes);

    struct Edge {
        std::string source, target;
        /// Poses target_from_source. If the edge is fixed, one pose, whose time is
        /// meaningless.
        PoseTrack track;
        bool is_fixed = false;
    };
    struct Step {
        const Edge* edge = nullptr;
        bool is_reverse = false;  ///< true: from the target of the edge to its source

        const std::string& begin() const { return is_reverse ? edge->target : edge->source; }
    };
    using Path = std::vector<Step>;

    bool has_frame(const std::string& name) const;
    /// Returns the way between two frames, or nothing if they are not connected.
    std::optional<Path> find_path(const std::string& source, const std::string& target) const;

    static bool is_fixed(const Path& path);
    /// Returns true if all moving poses of a path are known at a time.
    static bool is_known(const Path& path, double time_s);
    static Pose pose_at(const Path& path, double time_s);  ///< Returns target_from_source.

private:
    std::vector<Edge> edges_;
};

}  // namespace relidar::ncore
