// SPDX-License-Identifier: Apache-2.0
// Reads the points of a cloud message. Supports any order, type and padding of the fields
// and both byte orders.
#include <algorithm>

#include <fmt/format.h>

#include <relidar/base/error.hpp>

#include "base/fail.hpp"
#include "base/files.hpp"
#include "read/bag/messages.hpp"

namespace relidar::bag {
namespace {

/// Returns the memory layout of a point: its known fields, sorted by offset. Unused
/// fields fill the gaps between the known fields.
std::vector<read::PointField> make_layout(const CloudMessage& cloud,
                                          const std::vector<CloudMessage::CloudField>& sorted_fields) {
    std::vector<read::PointField> layout;
    std::size_t at = 0;
    const auto skip_to = [&](std::size_t offset) {
        if (offset > at) layout.push_back({std::string(read::kPaddingName), 'U', 1, offset - at});
        at = offset;
    };
    for (const CloudMessage::CloudField& field : sorted_fields) {
        if (field.offset < at)
            fail(
                "the field '{}' starts at byte {} of a point and overlaps another field, expected byte {} or "
                "more",
                quote(field.name), field.offset, at);
        skip_to(field.offset);
        layout.push_back({field.name, field.kind, field.size, field.count});
        at += field.size * field.count;
    }
    skip_to(cloud.point_step);
    return layout;
}

/// Copies all points of a cloud. Removes the padding between rows, and converts the
/// values to the byte order of this computer.
std::string pack_points(const CloudMessage& cloud, const std::vector<CloudMessage::CloudField>& fields) {
    const std::size_t row = cloud.width * cloud.point_step;
    std::string points;
    points.reserve(cloud.height * row);
    for (std::size_t r = 0; r < cloud.height; ++r)
        points += cloud.data.substr(r * (cloud.height > 1 ? cloud.row_step : 0), row);
    // The last point may be truncated. Its missing bytes become 0.
    points.resize(cloud.height * row, '\0');
    if (!cloud.is_big_endian) return points;
    for (std::size_t i = 0; i < cloud.size(); ++i)
        for (const CloudMessage::CloudField& field : fields)
            std::reverse(points.begin() + std::ptrdiff_t(i * cloud.point_step + field.offset),
                         points.begin() + std::ptrdiff_t(i * cloud.point_step + field.offset + field.size));
    return points;
}

}  // namespace

read::PointTable to_point_table(const CloudMessage& cloud, const SharedBytes& message_bytes) {
    if (cloud.size() == 0) throw DataError("the cloud has no points, expected at least one");
    std::vector<CloudMessage::CloudField> point_fields;
    std::ranges::copy_if(cloud.fields, std::back_inserter(point_fields),
                         [](const CloudMessage::CloudField& f) { return read::is_known_field(f.name); });
    std::ranges::sort(point_fields, {}, &CloudMessage::CloudField::offset);
    const std::size_t n_bytes = cloud.size() * cloud.point_step;
    // Points without gaps between rows, in our byte order, are not copied.
    const bool is_packed = !cloud.is_big_endian && cloud.data.size() >= n_bytes &&
                           (cloud.height <= 1 || cloud.row_step == cloud.width * cloud.point_step);
    const std::vector<read::PointField> layout = make_layout(cloud, point_fields);
    const SharedBytes points = is_packed ? message_bytes.share_part(cloud.data.substr(0, n_bytes))
                                         : share_bytes(pack_points(cloud, point_fields));
    read::PointTable table =
        read::table_of_records(points, layout, cloud.size(), read::PointMemoryLayout::by_point, "points");
    for (const CloudMessage::CloudField& field : cloud.fields)
        if (!read::is_known_field(field.name)) table.unread.push_back(field.name);
    return table;
}

}  // namespace relidar::bag
