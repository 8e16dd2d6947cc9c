// SPDX-License-Identifier: Apache-2.0
// Models water on level ground as a smooth film on a diffuse surface (Lekner and Dorf,
// "Why some things are darker when wet", Applied Optics 1988). The water darkens the
// ground and mirrors objects. The effect finds the ground in a scan and traces the
// mirrored rays.

#include "base/geometry/cell_key.hpp"
#include "base/parallel.hpp"
#include "base/sigmoid.hpp"
#include "simulate/weather/air.hpp"

namespace relidar {
namespace {

constexpr double kWaterIndex = 1.33;      // refractive index of water in the near infrared
constexpr double kTextureDepth_mm = 1.0;  // depth of the texture of asphalt

constexpr double kCellSize_m = 2.0;
constexpr double kGroundLayer_m = 0.25;     // height of ground points above the lowest point of their cell
constexpr double kMaxPlaneError_m = 0.1;    // root mean square distance of the points from the plane
constexpr double kMaxSlope = 0.25;          // maximum slope of ground, rise over run
constexpr double kMinPointsPerPlane = 6.0;  // minimum number of points for a plane
// If the points form a narrower strip, the slope across the strip is unknown: 0.
constexpr double kMinStripWidth_m = 0.2;

/// Sums over points, relative to the sensor, along the axes of the world.
struct GroundGridCell {
    double lowest_m = std::numeric_limits<double>::infinity();
    double n = 0.0;
    glm::dvec3 sum{0.0};
    glm::dmat3 products{0.0};  // of two coordinates of the same point

    void add_point(const glm::dvec3& point) {
        n += 1.0;
        sum += point;
        products += glm::outerProduct(point, point);
    }
    void add_cell_sums(const GroundGridCell& other) {
        n += other.n;
        sum += other.sum;
        products += other.products;
    }
};
using GroundGrid = std::unordered_map<std::uint64_t, GroundGridCell>;

std::uint64_t ground_cell_key(const glm::dvec3& point) {
    return grid_key({point.x, point.y, 0.0}, kCellSize_m);
}

/// Plane of the ground: z = height + slope . (x, y).
struct GroundPlane {
    double height_m = 0.0;
    glm::dvec2 slope{0.0};
    bool is_ground = false;
};

/// Fits a plane z = height + slope . (x, y) to the points of a cell by least squares: the
/// slope solves (variances of x and y) slope = (covariances with z). The ridge, which is
/// added to the variances, keeps the slope small across a narrow strip of points.
GroundPlane fit_ground_plane(const GroundGridCell& cell) {
    if (cell.n < kMinPointsPerPlane) return {};
    const glm::dvec3 mean = cell.sum / cell.n;
    const auto covariance = [&](int a, int b) { return cell.products[a][b] / cell.n - mean[a] * mean[b]; };
    const double ridge = kMinStripWidth_m * kMinStripWidth_m, xx = covariance(0, 0) + ridge,
                 xy = covariance(0, 1), yy = covariance(1, 1) + ridge, zz = covariance(2, 2);
    const glm::dvec2 with_z(covariance(0, 2), covariance(1, 2));
    const glm::dvec2 slope =
        glm::dvec2(yy * with_z.x - xy * with_z.y, xx * with_z.y - xy * with_z.x) / (xx * yy - xy * xy);
    // Variance of the heights around the plane, slightly increased by the ridge.
    const double squared_m2 = zz - glm::dot(slope, with_z);
    return {.height_m = mean.z - glm::dot(slope, glm::dvec2(mean)),
            .slope = slope,
            .is_ground = squared_m2 < kMaxPlaneError_m * kMaxPlaneError_m && glm::length(slope) < kMaxSlope};
}

/// Returns the hit point of each ray that can have hit the ground: the background below
/// the sensor. Points are relative to the sensor, along the axes of the world.
std::vector<std::optional<glm::dvec3>> points_below_sensor(const RenderedScan& scan) {
    std::vector<std::optional<glm::dvec3>> points(scan.median_range_m.size());
    parallel_blocks(points.size(), [&](std::size_t ray) {
        if (scan.instance[ray] != 0 || !is_ray_returned(scan.image.drop_prob[ray], scan.median_range_m[ray]))
            return;
        const glm::dvec3 p =
            scan.firing_pose(ray) * glm::dvec3(scan.end_of(ray)) - scan.world_from_sensor.translation;
        if (p.z < 0.0) points[ray] = p;
    });
    return points;
}

/// Sums the points of each cell that are at most kGroundLayer_m above its lowest point.
GroundGrid ground_cells(const std::vector<std::optional<glm::dvec3>>& points) {
    GroundGrid cells;
    for (const std::optional<glm::dvec3>& p : points) {
        if (!p) continue;
        double& lowest_m = cells[ground_cell_key(*p)].lowest_m;
        lowest_m = std::min(lowest_m, p->z);
    }
    for (const std::optional<glm::dvec3>& p : points) {
        if (!p) continue;
        GroundGridCell& cell = cells[ground_cell_key(*p)];
        if (p->z < cell.lowest_m + kGroundLayer_m) cell.add_point(*p);
    }
    return cells;
}

/// Fits a plane to the cell of a point and the eight cells around it.
GroundPlane fit_plane_near(const GroundGrid& cells, const glm::dvec3& point) {
    GroundGridCell together;
    for (int dx = -1; dx <= 1; ++dx)
        for (int dy = -1; dy <= 1; ++dy)
            if (const auto cell = cells.find(ground_cell_key(point + kCellSize_m * glm::dvec3(dx, dy, 0)));
                cell != cells.end())
                together.add_cell_sums(cell->second);
    return fit_ground_plane(together);
}

/// Finds the rays that hit level ground below the sensor, of any material. A cell is
/// ground if the low points of the 3 x 3 cells around it fit a plane.
/// @return [rays] unit normal in the world frame of the dataset, or 0 without ground
std::vector<glm::dvec3> ground_normals_of(const RenderedScan& scan) {
    const std::vector<std::optional<glm::dvec3>> points = points_below_sensor(scan);
    const GroundGrid cells = ground_cells(points);
    std::unordered_map<std::uint64_t, GroundPlane> planes;
    std::vector<glm::dvec3> normals(points.size(), glm::dvec3(0.0));
    for (std::size_t ray = 0; ray < points.size(); ++ray) {
        if (!points[ray]) continue;
        const glm::dvec3& p = *points[ray];
        const auto [plane, is_new] = planes.try_emplace(ground_cell_key(p));
        if (is_new) plane->second = fit_plane_near(cells, p);
        const auto& [height_m, slope, is_ground] = plane->second;
        const double above_plane_m = p.z - height_m - glm::dot(slope, glm::dvec2(p));
        if (is_ground && std::abs(above_plane_m) < kGroundLayer_m)
            normals[ray] = glm::normalize(glm::dvec3(-slope, 1.0));
    }
    return normals;
}

/// Returns the fraction of diffuse light that a water film reflects: the mean reflectance
/// over all directions, weighted by the cosine.
double mean_reflectance() {
    constexpr int kCosineSteps = 1000;
    double sum = 0.0;
    for (int i = 0; i < kCosineSteps; ++i) {
        const double cosine = (i + 0.5) / kCosineSteps;
        sum += 2.0 * cosine * water_reflectance(cosine) / kCosineSteps;
    }
    return sum;
}

struct WetGroundRay {
    double through_water = 1.0;  // brightness of the wet ground relative to the dry ground
    double mirrors = 0.0;        // light that remains after two reflections at the water
    LidarEcho mirrored{};        // return of the object that the mirrored ray hits
};

struct WetGroundRays {
    std::vector<WetGroundRay> of_scan;   // [rays of the scan]
    WorldRays mirrored;                  // rays that the water mirrors
    std::vector<std::size_t> scan_rays;  // [mirrored] index of the mirrored ray in the scan
};

// Mirrored rays start above the water, so that they do not hit the rough ground itself.
constexpr double kRayLift_m = 0.1;
constexpr double kMinMirroredHeight_m = 0.3;  // hits below this height belong to the ground

float drop_chance(const RenderedRayValues& rendering, std::size_t ray) {
    return sigmoid(rendering.drop_logit[ray] - rendering.hit_logit[ray]);
}

/// Computes the brightness of the wet ground, and the rays that the water mirrors. Leaves
/// out mirrored rays that return less light than the ground.
/// @param normals [rays] unit normal of the ground, or 0 for a ray that hits no ground
WetGroundRays mirror_rays(const WeatherInput& input, const std::vector<glm::dvec3>& normals) {
    const RenderedScan& scan = input.scan;
    const double wet_share = film_fraction(input.weather.wet_mm);  // of the ground under water
    WetGroundRays rays{.of_scan = std::vector<WetGroundRay>(normals.size())};
    FiringPoseInterpolator firing(scan);
    for (std::size_t i = 0; i < normals.size(); ++i) {
        const Pose& pose = firing.pose_of(i);
        const glm::dvec3 direction = pose.rotation * glm::dvec3(scan.image.direction[i]);
        const double range_m = scan.median_range_m[i], cosine = -glm::dot(direction, normals[i]);
        if (!(cosine > 0.0)) continue;
        // An intensity is the reflectivity multiplied by a factor that depends on range.
        const double albedo = scan.image.intensity[i] / input.response.range_factor(range_m);
        WetGroundRay& wet = rays.of_scan[i];
        wet.through_water = 1.0 - wet_share + wet_share * wet_ratio(cosine, albedo);
        // The water reflects the light on its way to the object and on its way back.
        wet.mirrors = wet_share * std::pow(water_reflectance(cosine), 2);
        // A sensor with one return reports the brighter of the wet ground
        // (`through_water` * albedo) and the mirrored object (at most `mirrors`).
        if (scan.second_returns.empty() && wet.mirrors <= wet.through_water * albedo) continue;
        const glm::dvec3 hit_m =
            pose * glm::dvec3(scan.image.origin[i]) + range_m * direction - input.world_offset_m;
        rays.mirrored.origin.push_back(glm::vec3(hit_m + kRayLift_m * normals[i]));
        rays.mirrored.direction.push_back(glm::vec3(direction + 2.0 * cosine * normals[i]));
        rays.mirrored.time_s.push_back(scan.time_offset_s[i]);
        rays.scan_rays.push_back(i);
    }
    return rays;
}

/// Returns the wet ground at each ray of a scan. Traces the mirrored rays to find the
/// objects that they hit.
std::vector<WetGroundRay> wet_ground_rays(const WeatherInput& input) {
    const std::vector<glm::dvec3> normals = ground_normals_of(input.scan);
    WetGroundRays wet = mirror_rays(input, normals);
    const RenderedRayValues hits = wet.scan_rays.empty() ? RenderedRayValues{} : input.trace(wet.mirrored);
    for (std::size_t k = 0; k < hits.size(); ++k) {
        const std::size_t ray = wet.scan_rays[k];
        const double from_water_m = hits.median_depth[k];  // 0 if the mirrored ray hits nothing
        const glm::dvec3 direction(wet.mirrored.direction[k]);
        if (!(from_water_m > 0.0) || drop_chance(hits, k) >= kDropThreshold) continue;
        const double height_m = kRayLift_m + from_water_m * glm::dot(direction, normals[ray]);
        if (height_m < kMinMirroredHeight_m) continue;  // the mirrored ray hits the ground again
        // The sensor measures the length of the path via the water.
        LidarEcho& echo = wet.of_scan[ray].mirrored;
        echo.range_m = double(input.scan.median_range_m[ray]) + from_water_m;
        echo.reflectivity = std::min(double(hits.intensity[k]), 1.0);
        echo.source = ReturnCause::mirror;
        if (!input.motion) continue;
        const glm::dvec3 hit_m = glm::dvec3(wet.mirrored.origin[k]) + from_water_m * direction;
        const glm::dvec3 object_mps =
            input.motion->object_velocity(hits.instance[k], double(wet.mirrored.time_s[k]), hit_m);
        echo.away_mps = glm::dot(direction, object_mps);  // positive if the range increases
    }
    return std::move(wet.of_scan);
}

class WetGroundEffect : public RayWeatherEffect {
public:
    explicit WetGroundEffect(const WeatherInput& input)
        : sensor_(input.sensor), alpha_(extinction_per_m(input.weather)), wet_(wet_ground_rays(input)) {}

    void modify_surface(RayWeatherState& ray) const override {
        ray.through_water = wet_[ray.index].through_water;
    }
    void append_returns(EchoCandidates& candidates, const RayWeatherState& ray, Random&) const override {
        const WetGroundRay& wet = wet_[ray.index];
        append_detectable(candidates, wet.mirrored, sensor_,
                          std::exp(-2.0 * alpha_ * wet.mirrored.range_m) * wet.mirrors);
    }

private:
    const WeatherSensorProperties sensor_;
    const double alpha_;
    const std::vector<WetGroundRay> wet_;  // [rays]
};

constexpr WeatherParameter kWetNumbers[] = {
    {[](Weather& weather) -> double& { return weather.wet_mm; }, 0.0, 10.0}};

}  // namespace

double water_reflectance(double cosine) {
    // Snell's law
    const double in_water = std::sqrt(1.0 - (1.0 - cosine * cosine) / (kWaterIndex * kWaterIndex));
    const double across = (cosine - kWaterIndex * in_water) / (cosine + kWaterIndex * in_water),
                 along = (in_water - kWaterIndex * cosine) / (in_water + kWaterIndex * cosine);
    return 0.5 * (across * across + along * along);
}

double wet_ratio(double cosine, double albedo) {
    // light that stays in the film because of total internal reflection
    static const double trapped_fraction = 1.0 - (1.0 - mean_reflectance()) / (kWaterIndex * kWaterIndex);
    const double passes = 1.0 - water_reflectance(cosine);
    return passes * passes /
           (kWaterIndex * kWaterIndex * (1.0 - std::clamp(albedo, 0.0, 1.0) * trapped_fraction));
}

double film_fraction(double water_depth_mm) {
    return std::clamp(water_depth_mm / kTextureDepth_mm, 0.0, 1.0);
}

const WeatherEffectEntry kWetGroundEffect{
    .name = "wet",
    .form = "wet=MILLIMETRES",
    .meaning = "water on level ground",
    .expected = "a depth of 0 to 10 mm of water on the ground",
    .examples = "wet=0.5 rain=10,wet=0.5",
    .numbers = kWetNumbers,
    .prepare = [](const WeatherInput& input) -> std::unique_ptr<RayWeatherEffect> {
        return std::make_unique<WetGroundEffect>(input);
    }};

}  // namespace relidar
