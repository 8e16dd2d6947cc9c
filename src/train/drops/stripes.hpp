// SPDX-License-Identifier: Apache-2.0
// Selects stripes of columns of an image, to train a network that processes single
// pixels. Rays with similar directions are traced faster.
#pragma once

#include <cstddef>
#include <vector>

#include <relidar/log/sensor.hpp>

namespace relidar {

/// If every n-th stripe of the image is used, they have about 32,768 pixels in total. If
/// n is below 2, the full image is used.
inline int choose_interval(const RayTable& rays) { return int(rays.size()) / 32768; }

/// The image covers a full turn, so its last column is next to its first.
class ImageStripes {
public:
    static constexpr int kStripeColumns = 64;  ///< columns in a stripe

    /// @param stripe_interval  n selects every n-th stripe; the full image if below 2 or
    /// larger than the number of stripes
    /// @param frame_number  each frame starts a stripe later, so that all columns occur
    ImageStripes(int stripe_interval, const RayTable& rays, std::size_t frame_number)
        : rows_(std::size_t(rays.rows)), columns_(std::size_t(rays.columns)) {
        const int n = rays.columns / kStripeColumns;
        if (stripe_interval < 2 || n < stripe_interval) return;
        for (int k = 0; k < n / stripe_interval; ++k)
            first_.push_back((frame_number + std::size_t(k * stripe_interval)) * kStripeColumns % columns_);
    }

    RayTable stripe_rays(const RayTable& image_rays) const {
        if (first_.empty()) return image_rays;
        RayTable some = select_rays(image_rays, list_pixels());
        some.rows = int(rows_);
        some.columns = int(first_.size()) * kStripeColumns;
        return some;
    }
    std::vector<float> stripe_values(const std::vector<float>& image_values) const {
        if (first_.empty()) return image_values;
        std::vector<float> some;
        for (const std::size_t i : list_pixels()) some.push_back(image_values[i]);
        return some;
    }

private:
    std::size_t rows_, columns_;
    std::vector<std::size_t> first_;  ///< first column of each stripe; empty if the full image is used

    std::vector<std::size_t> list_pixels() const {
        std::vector<std::size_t> pixel_indices;
        for (std::size_t row = 0; row < rows_; ++row)
            for (const std::size_t first : first_)
                for (std::size_t c = 0; c < kStripeColumns; ++c)
                    pixel_indices.push_back(row * columns_ + (first + c) % columns_);
        return pixel_indices;
    }
};

}  // namespace relidar
