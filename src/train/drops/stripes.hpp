// SPDX-License-Identifier: Apache-2.0
// Selects stripes of columns of an image, to train a network that processes single
// pixels. Such a network has about a thousand parameters, so it does not need every pixel
// of every frame. A stripe has neighbouring columns, because rays with similar directions
// are traced faster.
#pragma once

#include <cstddef>
#include <vector>

#include <relidar/log/sensor.hpp>

namespace relidar {

/// Returns a number n such that every n-th stripe of the image gives about 32,768 pixels.
/// A number below 2 means the full image.
inline int compute_stripe_share(const RayTable& rays) { return int(rays.size()) / 32768; }

/// Some vertical stripes of an image. The image covers a full turn, so its last column is
/// next to its first.
class Stripes {
public:
    static constexpr int kColumns = 64;  ///< columns in a stripe

    /// Selects the stripes of a frame. Uses the full image if `share` is below 2 or
    /// larger than the number of stripes.
    /// @param share  n selects every n-th stripe
    /// @param of_frame  number of the frame; each frame starts one stripe later, so that
    /// the frames together use all columns
    Stripes(int share, const RayTable& rays, std::size_t of_frame)
        : rows_(std::size_t(rays.rows)), columns_(std::size_t(rays.columns)) {
        const int n = rays.columns / kColumns;
        if (share < 2 || n < share) return;
        for (int k = 0; k < n / share; ++k)
            first_.push_back((of_frame + std::size_t(k * share)) * kColumns % columns_);
    }

    /// Returns the rays of the stripes, as an image with rows and columns.
    /// @param all  rays of the full image
    RayTable rays(const RayTable& all) const {
        if (first_.empty()) return all;
        RayTable some = select_rays(all, places());
        some.rows = int(rows_);
        some.columns = int(first_.size()) * kColumns;
        return some;
    }
    /// Returns the values of the pixels in the stripes.
    /// @param all [rows,columns] values of the full image
    std::vector<float> values(const std::vector<float>& all) const {
        if (first_.empty()) return all;
        std::vector<float> some;
        for (const std::size_t i : places()) some.push_back(all[i]);
        return some;
    }

private:
    std::size_t rows_, columns_;
    std::vector<std::size_t> first_;  ///< first column of each stripe; empty if the full image is used

    std::vector<std::size_t> places() const {
        std::vector<std::size_t> places;
        for (std::size_t row = 0; row < rows_; ++row)
            for (const std::size_t first : first_)
                for (std::size_t c = 0; c < kColumns; ++c)
                    places.push_back(row * columns_ + (first + c) % columns_);
        return places;
    }
};

}  // namespace relidar
