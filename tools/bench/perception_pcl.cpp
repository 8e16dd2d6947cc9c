// SPDX-License-Identifier: Apache-2.0
// Runs algorithms of PCL on KITTI .bin files. tools/bench/perception builds this program.
//
//   odometry FILE...    prints for each pair of files in sequence 12 numbers: the pose of the
//                       second scan in the frame of the first (3 x 4, by rows). GICP.
//   label FILE...       writes FILE.labels, an int32 per point: -1 ground, 0 other, n cluster n
//   nearest REAL FILE   writes FILE.nearest, an int32 per point: index of the nearest real point,
//                       -1 if that is more than 0.2 m away
#include <pcl/filters/voxel_grid.h>
#include <pcl/kdtree/kdtree_flann.h>
#include <pcl/registration/gicp.h>
#include <pcl/segmentation/approximate_progressive_morphological_filter.h>
#include <pcl/segmentation/extract_clusters.h>

#include <cstdint>
#include <cstdio>
#include <fstream>
#include <stdexcept>
#include <string>
#include <vector>

using Cloud = pcl::PointCloud<pcl::PointXYZ>;

constexpr float kOdometryLeafM = 0.25f, kClusterLeafM = 0.2f, kMaxPairM = 0.2f, kMaxLabelRangeM = 80.0f;
constexpr int kMinClusterCells = 10, kNoLabel = 0, kGround = -1;

Cloud::Ptr read_bin(const std::string& path) {
    std::ifstream file(path, std::ios::binary);
    if (!file) throw std::runtime_error("cannot read " + path);
    Cloud::Ptr cloud(new Cloud);
    for (float point[4]; file.read(reinterpret_cast<char*>(point), sizeof point);)
        cloud->push_back({point[0], point[1], point[2]});
    return cloud;
}

void write_ints(const std::string& path, const std::vector<std::int32_t>& values) {
    std::ofstream file(path, std::ios::binary);
    file.write(reinterpret_cast<const char*>(values.data()), values.size() * sizeof(std::int32_t));
    if (!file.flush()) throw std::runtime_error("cannot write " + path);
}

Cloud::Ptr downsample(const Cloud::Ptr& cloud) {
    pcl::VoxelGrid<pcl::PointXYZ> grid;
    grid.setInputCloud(cloud);
    grid.setLeafSize(kOdometryLeafM, kOdometryLeafM, kOdometryLeafM);
    Cloud::Ptr result(new Cloud);
    grid.filter(*result);
    return result;
}

// Registers each scan with the scan before it by GICP. Prints the first three rows of the
// matrix that transforms points of a scan to the previous scan. The first guess is the
// motion of the last step.
void run_odometry(const std::vector<std::string>& files) {
    Eigen::Matrix4f motion = Eigen::Matrix4f::Identity();
    Cloud::Ptr last = downsample(read_bin(files.at(0)));
    for (std::size_t i = 1; i < files.size(); ++i) {
        const Cloud::Ptr next = downsample(read_bin(files[i]));
        pcl::GeneralizedIterativeClosestPoint<pcl::PointXYZ, pcl::PointXYZ> gicp;
        gicp.setMaxCorrespondenceDistance(1.0);
        gicp.setTransformationEpsilon(1e-4);
        gicp.setRotationEpsilon(1e-4);
        gicp.setMaximumIterations(50);
        gicp.setInputTarget(last);
        gicp.setInputSource(next);
        Cloud aligned;
        gicp.align(aligned, motion);
        motion = gicp.getFinalTransformation();
        for (int row = 0; row < 3; ++row)
            for (int column = 0; column < 4; ++column)
                std::printf("%.9g%c", motion(row, column), row == 2 && column == 3 ? '\n' : ' ');
        last = next;
    }
}

// Finds ground with a progressive morphological filter, and Euclidean clusters of all
// other points up to kMaxLabelRangeM. It clusters occupied cells, because this is fast.
void label_points(const std::string& path) {
    const Cloud::Ptr cloud = read_bin(path);
    pcl::IndicesPtr near(new pcl::Indices);
    for (std::size_t i = 0; i < cloud->size(); ++i)
        if ((*cloud)[i].getVector3fMap().norm() < kMaxLabelRangeM) near->push_back(static_cast<int>(i));
    // The filter places its grid at the lowest coordinates. A corner makes the grid the
    // same for all scans.
    Cloud::Ptr with_corner(new Cloud(*cloud, *near));
    with_corner->push_back({-kMaxLabelRangeM, -kMaxLabelRangeM, 1e3f});
    pcl::ApproximateProgressiveMorphologicalFilter<pcl::PointXYZ> filter;
    filter.setInputCloud(with_corner);
    filter.setMaxWindowSize(20);
    filter.setSlope(0.3f);
    filter.setInitialDistance(0.25f);
    filter.setMaxDistance(1.0f);
    filter.setCellSize(0.5f);
    filter.setNumberOfThreads(1);
    pcl::Indices ground;
    filter.extract(ground);
    std::vector<std::int32_t> labels(cloud->size(), kNoLabel);
    // The corner is the last point of its cloud and gets no label.
    for (const int i : ground)
        if (i < static_cast<int>(near->size())) labels[(*near)[i]] = kGround;

    Cloud::Ptr other(new Cloud);
    for (const int i : *near)
        if (labels[i] != kGround) other->push_back((*cloud)[i]);
    pcl::VoxelGrid<pcl::PointXYZ> grid;
    grid.setInputCloud(other);
    grid.setLeafSize(kClusterLeafM, kClusterLeafM, kClusterLeafM);
    grid.setSaveLeafLayout(true);
    Cloud::Ptr cells(new Cloud);
    grid.filter(*cells);
    pcl::EuclideanClusterExtraction<pcl::PointXYZ> extraction;
    extraction.setInputCloud(cells);
    extraction.setClusterTolerance(0.5);
    extraction.setMinClusterSize(kMinClusterCells);
    std::vector<pcl::PointIndices> clusters;
    extraction.extract(clusters);
    std::vector<std::int32_t> cluster_of(cells->size(), kNoLabel);
    for (std::size_t c = 0; c < clusters.size(); ++c)
        for (const int cell : clusters[c].indices) cluster_of[cell] = static_cast<int>(c) + 1;
    for (const int i : *near)
        if (labels[i] != kGround) labels[i] = cluster_of[grid.getCentroidIndex((*cloud)[i])];
    write_ints(path + ".labels", labels);
}

// Writes the index of the real point nearest to each point of a scan, or -1.
void find_nearest(const std::string& real, const std::string& path) {
    pcl::KdTreeFLANN<pcl::PointXYZ> tree;
    tree.setInputCloud(read_bin(real));
    const Cloud::Ptr cloud = read_bin(path);
    std::vector<std::int32_t> nearest;
    pcl::Indices index(1);
    std::vector<float> distance_sq(1);
    for (const auto& point : *cloud) {
        const bool is_near =
            tree.nearestKSearch(point, 1, index, distance_sq) == 1 && distance_sq[0] < kMaxPairM * kMaxPairM;
        nearest.push_back(is_near ? index[0] : -1);
    }
    write_ints(path + ".nearest", nearest);
}

int main(int argc, char** argv) try {
    const std::vector<std::string> words(argv + 1, argv + argc);
    if (words.size() > 1 && words[0] == "odometry") run_odometry({words.begin() + 1, words.end()});
    else if (words.size() > 1 && words[0] == "label")
        for (std::size_t i = 1; i < words.size(); ++i) label_points(words[i]);
    else if (words.size() == 3 && words[0] == "nearest") find_nearest(words[1], words[2]);
    else throw std::runtime_error("usage: odometry FILE... | label FILE... | nearest REAL FILE");
} catch (const std::exception& error) {
    std::fprintf(stderr, "perception_pcl: %s\n", error.what());
    return 1;
}
