// SPDX-License-Identifier: Apache-2.0
#include "tables/published_numbers.hpp"

#include <array>
#include <vector>

namespace relidar::cli {
namespace {

/// The columns of Tables 1 and 2, left to right.
constexpr std::array kPrinted = {"fps",
                                 "memory_gb",
                                 "peer/depth_rmse_m",
                                 "peer/depth_medae_m",
                                 "peer/depth_lpips",
                                 "peer/depth_ssim",
                                 "peer/depth_psnr_db",
                                 "peer/intensity_rmse",
                                 "peer/intensity_medae",
                                 "peer/intensity_lpips",
                                 "peer/intensity_ssim",
                                 "peer/intensity_psnr_db",
                                 "peer/cd_sq_m2",
                                 "peer/f_score"};

PublishedRow row(const std::string& method, const std::array<double, kPrinted.size()>& numbers) {
    PublishedRow result{method, {}};
    for (std::size_t i = 0; i < numbers.size(); ++i) result.values[kPrinted[i]] = numbers[i];
    return result;
}

/// Table 3: depth RMSE, SSIM, PSNR, the same of intensity, CD, F-score.
MetricRow table_3(const std::array<double, 8>& n) {
    return {{"peer/depth_rmse_m", n[0]},   {"peer/depth_ssim", n[1]},        {"peer/depth_psnr_db", n[2]}, {"peer/intensity_rmse", n[3]},
            {"peer/intensity_ssim", n[4]}, {"peer/intensity_psnr_db", n[5]}, {"peer/cd_sq_m2", n[6]},      {"peer/f_score", n[7]}};
}

/// The supplement's: depth RMSE, LPIPS, PSNR, CD, F-score.
MetricRow supplement(const std::array<double, 5>& n) {
    return {{"peer/depth_rmse_m", n[0]},
            {"peer/depth_lpips", n[1]},
            {"peer/depth_psnr_db", n[2]},
            {"peer/cd_sq_m2", n[3]},
            {"peer/f_score", n[4]}};
}

MetricRow with_fps(MetricRow values, double fps) {
    values["fps"] = fps;
    return values;
}

}  // namespace

std::span<const PublishedRow> published_rows(const std::string& kind) {
    static const std::vector<PublishedRow> waymo = {
        row("LiDAR-NeRF", {0.98, 1.6, 7.7258, 0.0518, 0.3414, 0.6817, 20.5204, 0.0659, 0.0108, 0.1893, 0.7492, 23.1612, 0.1815, 0.9184}),
        row("DyNFL", {0.21, 14.9, 6.9787, 0.0388, 0.3010, 0.7080, 21.3094, 0.0662, 0.0093, 0.1382, 0.7555, 24.0473, 0.1182, 0.7786}),
        row("LiDAR4D", {0.17, 7.7, 6.6234, 0.0379, 0.3406, 0.7008, 21.8413, 0.0634, 0.0086, 0.1854, 0.7756, 24.0838, 0.1060, 0.9437}),
        row("LiDAR-RT", {20.1, 1.37, 6.4577, 0.0340, 0.2918, 0.7330, 22.1581, 0.0627, 0.0101, 0.1652, 0.7828, 23.9079, 0.1002, 0.9458})};
    static const std::vector<PublishedRow> kitti360 = {
        row("PCGen", {0.05, 5.23, 5.6853, 0.2040, 0.5391, 0.4903, 23.1675, 0.1970, 0.0763, 0.5926, 0.1351, 14.1181, 0.4636, 0.8023}),
        row("LiDARsim", {0.9, 0.76, 6.9153, 0.1279, 0.2926, 0.6342, 21.4608, 0.1666, 0.0569, 0.3276, 0.3502, 15.5853, 3.2228, 0.7157}),
        row("LiDAR-NeRF", {1.8, 1.61, 4.0886, 0.0556, 0.2712, 0.6309, 26.0590, 0.1464, 0.0438, 0.3590, 0.3567, 16.7621, 0.1502, 0.9073}),
        row("LiDAR4D", {0.4, 7.38, 3.5256, 0.0404, 0.1051, 0.7647, 27.4767, 0.1195, 0.0327, 0.1845, 0.5304, 18.5561, 0.1089, 0.9272}),
        row("LiDAR-RT", {42.7, 0.41, 3.4671, 0.0512, 0.1016, 0.8406, 27.6755, 0.1115, 0.0271, 0.1812, 0.6077, 19.0862, 0.1077, 0.9255})};
    return kind == "waymo" ? waymo : kitti360;
}

std::span<const Ablation> ablations() {
    static const std::vector<Ablation> rows = {
        {"no_chamfer", "w/o L_CD", "loss.chamfer=0", table_3({3.5053, 0.8393, 27.5526, 0.1120, 0.6068, 19.0553, 0.1192, 0.9464})},
        {"no_normals", "w/o I: normals at initialisation", "init.normals=false",
         table_3({4.0597, 0.8343, 26.2554, 0.1141, 0.6024, 18.8896, 0.1363, 0.9389})},
        {"one_logit", "w/o M: one drop logit", "image.single_drop_logit=true",
         table_3({3.7445, 0.7989, 26.9473, 0.1179, 0.5687, 18.6051, 0.1234, 0.9286})},
        {"one_logit", "w/o R_hit: one drop logit", "image.single_drop_logit=true",   // the supplement's, of the same run here
         supplement({4.5482, 0.4503, 25.2371, 0.1592, 0.9089})},
        {"no_network", "w/o R_refine: no U-Net", "", supplement({4.4635, 0.4338, 25.3924, 0.1485, 0.9119})},
        {"no_rays", "w/o R_spatial: U-Net without rays", "refine.rays=none", supplement({3.7571, 0.1480, 26.9385, 0.1247, 0.9249})},
        {"gaussians", "3D Gaussians", "image.primitive=gaussian", with_fps(supplement({3.6716, 0.1145, 27.0976, 0.3553, 0.8899}), 29)}};
    return rows;
}

}  // namespace relidar::cli
