// SPDX-License-Identifier: Apache-2.0
// Stretches of columns, in place of a whole image, for a network of single pixels: its
// thousand parameters do not need every pixel of every frame. Neighbouring columns stay
// together, because rays that look the same way are traced faster together.
#pragma once

#include <cstddef>
#include <vector>

#include <relidar/log/sensor.hpp>

namespace relidar {

/// One stripe in so many leaves about 32,768 pixels of an image. @return below 2: all of
/// it
inline int stripe_share(const RayTable& rays) { return int(rays.size()) / 32768; }

/// Columns are a ring.
class Stripes {
public:
    static constexpr int kColumns = 64;  ///< of a stripe

    /// @param share  one stripe in so many is taken; below 2, or of an image that has not
    /// as many stripes, the whole image is
    /// @param of_frame  number of the frame: each begins a stripe further, so that
    /// together they see all columns
    Stripes(int share, const RayTable& rays, std::size_t of_frame)
        : rows_(std::size_t(rays.rows)), columns_(std::size_t(rays.columns)) {
        const int n = rays.columns / kColumns;
        if (share < 2 || n < share) return;
        for (int k = 0; k < n / share; ++k)
            first_.push_back((of_frame + std::size_t(k * share)) * kColumns % columns_);
    }

    /// The rays of the stripes, as an image. @param all  of the whole image
    RayTable rays(const RayTable& all) const {
        if (first_.empty()) return all;
        RayTable some = some_rays(all, places());
        some.rows = int(rows_);
        some.columns = int(first_.size()) * kColumns;
        return some;
    }
    /// @param all [rows,columns] of the whole image @return those of the stripes' pixels
    std::vector<float> values(const std::vector<float>& all) const {
        if (first_.empty()) return all;
        std::vector<float> some;
        for (const std::size_t i : places()) some.push_back(all[i]);
        return some;
    }

private:
    std::size_t rows_, columns_;
    std::vector<std::size_t> first_;  ///< columns; none: the whole image

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
