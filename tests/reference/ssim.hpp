// SPDX-License-Identifier: Apache-2.0
// Computes the structural similarity of two intensity images (Wang et al. 2004) in
// double, with its derivative. The window has 11 x 11 pixels and a Gaussian of 1.5
// pixels, normalised over the pixels with a known value (docs/method.md section 5).
#pragma once

#include <vector>

namespace relidar::reference {

struct Image {
    int rows = 0;
    int columns = 0;
    bool circular = false;       ///< the first column is adjacent to the last column
    std::vector<double> x;       ///< [rows,columns] rendered
    std::vector<double> y;       ///< [rows,columns] measured
    std::vector<bool> is_known;  ///< [rows,columns] unknown pixels are ignored
};

/// Computes the structural similarity loss.
/// @param d_x if not null, receives the derivative with respect to x [rows,columns]
/// @return mean of 1 - S over the pixels with a known value, or 0 if no pixel has a known
/// value
double compute_ssim_loss(const Image& image, std::vector<double>* d_x = nullptr);

}  // namespace relidar::reference
