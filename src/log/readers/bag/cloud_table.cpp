// SPDX-License-Identifier: Apache-2.0
// Reads the points of a cloud message. Supports any order, type and padding of the fields
// and both byte orders.
#include <algorithm>

#include <fmt/format.h>

#include <relidar/base/error.hpp>

#include "base/files.hpp"
#include "log/readers/bag/messages.hpp"

namespace relidar::bag {
namespace {

/// Returns the memory layout of a point: its known fields, sorted by offset, with unused
/// fields that fill the gaps.
std::vector<folder::PointField> find_cloud_layout(const Cloud& cloud,
                                                  const std::vector<Cloud::Field>& fields) {
    std::vector<folder::PointField> layout;
    std::size_t at = 0;
    const auto skip_to = [&](std::size_t offset) {
        if (offset > at) layout.push_back({std::string(folder::kPadding), 'U', 1, offset - at});
        at = offset;
    };
    for (const Cloud::Field& field : fields) {
        if (field.offset < at)
            throw DataError(fmt::format(
                "the field '{}' starts at byte {} of a point and overlaps another field, expected byte {} "
                "or more",
                make_excerpt(field.name), field.offset, at));
        skip_to(field.offset);
        layout.push_back({field.name, field.kind, field.size, field.count});
        at += field.size * field.count;
    }
    skip_to(cloud.point_step);
    return layout;
}

/// Copies all points of a cloud. Removes the padding between rows, and converts the
/// values to the byte order of this computer.
std::string pack_points(const Cloud& cloud, const std::vector<Cloud::Field>& fields) {
    const std::size_t row = cloud.width * cloud.point_step;
    std::string points;
    points.reserve(cloud.height * row);
    for (std::size_t r = 0; r < cloud.height; ++r)
        points += cloud.data.substr(r * (cloud.height > 1 ? cloud.row_step : 0), row);
    // The last point may be truncated, so its missing bytes become 0.
    points.resize(cloud.height * row, '\0');
    if (!cloud.is_big_endian) return points;
    for (std::size_t i = 0; i < cloud.size(); ++i)
        for (const Cloud::Field& field : fields)
            std::reverse(points.begin() + std::ptrdiff_t(i * cloud.point_step + field.offset),
                         points.begin() + std::ptrdiff_t(i * cloud.point_step + field.offset + field.size));
    return points;
}

}  // namespace

folder::PointTable make_point_table(const Cloud& cloud, const SharedBytes& message) {
    if (cloud.size() == 0) throw DataError("the cloud has no points, expected at least one");
    std::vector<Cloud::Field> known;
    std::ranges::copy_if(cloud.fields, std::back_inserter(known),
                         [](const Cloud::Field& f) { return folder::is_point_field(f.name); });
    std::ranges::sort(known, {}, &Cloud::Field::offset);
    const std::size_t n_bytes = cloud.size() * cloud.point_step;
    const bool is_packed = !cloud.is_big_endian && cloud.data.size() >= n_bytes &&
                           (cloud.height <= 1 || cloud.row_step == cloud.width * cloud.point_step);
    const std::vector<folder::PointField> layout = find_cloud_layout(cloud, known);
    const SharedBytes points =
        is_packed ? message.with(cloud.data.substr(0, n_bytes)) : share_bytes(pack_points(cloud, known));
    folder::PointTable table =
        folder::read_packed(points, layout, cloud.size(), folder::Packing::by_point, "points");
    for (const Cloud::Field& field : cloud.fields)
        if (!folder::is_point_field(field.name)) table.unread.push_back(field.name);
    return table;
}

}  // namespace relidar::bag
