// Copyright 2026 debris_scanner maintainers
//
// Licensed under the Apache License, Version 2.0 (the "License");
// you may not use this file except in compliance with the License.
// You may obtain a copy of the License at
//
//     http://www.apache.org/licenses/LICENSE-2.0
//
// Unless required by applicable law or agreed to in writing, software
// distributed under the License is distributed on an "AS IS" BASIS,
// WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied.
// See the License for the specific language governing permissions and
// limitations under the License.

// One cloud through PCL's filters, features and surfaces.
#include "peers.h"

#include <pcl/features/normal_3d.h>
#include <pcl/features/vfh.h>
#include <pcl/filters/statistical_outlier_removal.h>
#include <pcl/filters/voxel_grid.h>
#include <pcl/search/kdtree.h>
#include <pcl/surface/gp3.h>
#include <pcl/surface/mls.h>

using Tree = pcl::search::KdTree<pcl::PointXYZ>;

NormalCloud::Ptr with_normals(const Cloud::ConstPtr& cloud, int neighbours) {
  pcl::NormalEstimation<pcl::PointXYZ, pcl::PointNormal> estimation;
  estimation.setInputCloud(cloud);
  estimation.setSearchMethod(Tree::Ptr(new Tree));
  estimation.setKSearch(neighbours);
  NormalCloud::Ptr out(new NormalCloud);
  estimation.compute(*out);
  for (std::size_t k = 0; k < cloud->size(); ++k) (*out)[k].getVector3fMap() = (*cloud)[k].getVector3fMap();
  return out;
}

static void voxel_grid(const Cloud::ConstPtr& cloud, float edge, Cloud& out) {
  pcl::VoxelGrid<pcl::PointXYZ> grid;
  grid.setInputCloud(cloud);
  grid.setLeafSize(edge, edge, edge);
  grid.filter(out);
}

// FOLDER/frame.f32: a target frame as an organised cloud; FOLDER/merged.f32: a model's points, merged.
void stages(const std::string& folder, int times) {
  const Cloud::Ptr frame = read_cloud(folder + "/frame.f32");
  Cloud::Ptr cloud(new Cloud);
  const std::vector<double> ms = repeat(times, [&] { voxel_grid(frame, 0.002f, *cloud); });
  report("voxel grid", ms, "\"points\": " + std::to_string(cloud->size()));
  NormalCloud::Ptr normals;
  report("normals", repeat(times, [&] { normals = with_normals(cloud, 20); }));
  report("descriptor", repeat(times, [&] {
    pcl::VFHEstimation<pcl::PointXYZ, pcl::PointNormal, pcl::VFHSignature308> vfh;
    vfh.setInputCloud(cloud);
    vfh.setInputNormals(normals);
    vfh.setSearchMethod(Tree::Ptr(new Tree));
    pcl::PointCloud<pcl::VFHSignature308> out;
    vfh.compute(out);
  }));

  const Cloud::Ptr merged = read_cloud(folder + "/merged.f32");
  const int few = std::max(1, times / 10);
  Cloud::Ptr clean(new Cloud);
  report("outliers", repeat(few, [&] {
    pcl::StatisticalOutlierRemoval<pcl::PointXYZ> filter;
    filter.setInputCloud(merged);
    filter.setMeanK(50);
    filter.setStddevMulThresh(3.0);
    filter.filter(*clean);
  }), "\"points\": " + std::to_string(merged->size()));
  NormalCloud::Ptr smooth(new NormalCloud);
  report("moving least squares", repeat(few, [&] {
    pcl::MovingLeastSquares<pcl::PointXYZ, pcl::PointNormal> mls;
    mls.setComputeNormals(true);
    mls.setInputCloud(clean);
    mls.setPolynomialOrder(5);
    mls.setSearchMethod(Tree::Ptr(new Tree));
    mls.setSearchRadius(0.005);
    mls.process(*smooth);
  }));
  pcl::PolygonMesh mesh;
  report("greedy projection", repeat(few, [&] {
    pcl::search::KdTree<pcl::PointNormal>::Ptr tree(new pcl::search::KdTree<pcl::PointNormal>);
    tree->setInputCloud(smooth);
    pcl::GreedyProjectionTriangulation<pcl::PointNormal> projection;
    projection.setSearchRadius(0.010);
    projection.setMu(2.5);
    projection.setMaximumNearestNeighbors(100);
    projection.setMaximumSurfaceAngle(M_PI / 4);
    projection.setMinimumAngle(M_PI / 18);
    projection.setMaximumAngle(2 * M_PI / 3);
    projection.setNormalConsistency(false);
    projection.setInputCloud(smooth);
    projection.setSearchMethod(tree);
    projection.reconstruct(mesh);
  }));
}
