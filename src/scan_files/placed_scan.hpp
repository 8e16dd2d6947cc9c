// SPDX-License-Identifier: Apache-2.0
// A scan with its rays in the frame that its files hold.
#pragma once

#include <optional>
#include <vector>

#include <glm/glm.hpp>

#include <relidar/export.hpp>
#include <relidar/math.hpp>
#include <relidar/render.hpp>
#include <relidar/scan_files.hpp>

namespace relidar::scan_files {

struct PlacedScan {
    const RenderedScan& scan;
    const ScanFormat& format;
    int frame;                                         ///< the dataset's number
    std::vector<glm::vec3> origin, direction, normal;  ///< [n], normals where they were rendered
    std::optional<std::vector<float>> spread_m;        ///< [n] where it was asked for
    FileNotes notes;

    const RangeImage& image() const { return scan.image; }
};

/// Rays in the frame that the format asks for. @param world_from_deskewed  of that of deskewed rays @param notes  of the files
PlacedScan place(const RenderedScan& scan, const ScanFormat& format, const Pose& world_from_deskewed, int frame, FileNotes notes = {});

/// Points of returned rays, second returns behind their first.
PointCloud cloud_of(const PlacedScan& placed);
/// Of rays that returned.
std::size_t count_points(const RenderedScan& scan, const Config& config);

}  // namespace relidar::scan_files
