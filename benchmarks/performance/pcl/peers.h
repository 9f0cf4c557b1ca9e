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

// What the parts of the peer program share: clouds as raw float32 files, CPU times, one JSON line a result.
#pragma once

#include <pcl/point_cloud.h>
#include <pcl/point_types.h>

#include <Eigen/Core>
#include <functional>
#include <string>
#include <vector>

using Cloud = pcl::PointCloud<pcl::PointXYZ>;
using NormalCloud = pcl::PointCloud<pcl::PointNormal>;

// x y z of every point, nothing else; points that are not numbers stay in.
Cloud::Ptr read_cloud(const std::string& path);

// Rigid transforms, sixteen numbers a line, row by row.
std::vector<Eigen::Matrix4f> read_poses(const std::string& path);

// CPU milliseconds of this process, all threads.
double cpu_ms();

// CPU milliseconds of each of several runs.
std::vector<double> repeat(int times, const std::function<void()>& task);

// One line of JSON: name, milliseconds of each run, and what else is to be told, as "key": value, ...
void report(const std::string& name, const std::vector<double>& ms, const std::string& more = "");

std::string json(const std::vector<Eigen::Matrix4f>& poses);

NormalCloud::Ptr with_normals(const Cloud::ConstPtr& cloud, int neighbours);

void stages(const std::string& folder, int times);
void pairs(const std::string& folder);
void lum(const std::string& folder, int outer, const std::string& edges, const std::string& name);
