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

/* What libfreenect says when a Kinect is there, forbidden, unplugged, hanging or crashing: a word in the file
 * that STUB_FREENECT names, read at each call. Declarations after libfreenect.h, version 0.5. */
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/time.h>
#include <unistd.h>

typedef struct {
	uint32_t reserved;
	int resolution;
	int32_t format, bytes;
	int16_t width, height;
	int8_t bits, padding, framerate, is_valid;
} mode_t_;

typedef struct {
	int32_t reg_info[29];
	uint16_t pad[3];
	float emitter, colour, reference_distance, pixel_size;
	double const_shift;
	void *tables[3];
} registration_t;

typedef void (*frame_cb)(void *device, void *data, uint32_t ticks);
typedef void (*log_cb)(void *context, int level, const char *text);

static frame_cb depth_cb, video_cb;
static log_cb log_to;
static int depth_runs, video_runs, depth_format;
static uint32_t ticks;
static uint16_t depth[640 * 480];
static uint8_t video[640 * 480 * 3];

static int is(const char *word)
{
	char text[32] = "";
	FILE *file = fopen(getenv("STUB_FREENECT"), "r");
	if (file) {
		if (fscanf(file, "%31s", text) != 1)
			text[0] = 0;
		fclose(file);
	}
	return strcmp(text, word) == 0;
}

int freenect_init(void **context, void *usb) { *context = &ticks; return 0; }
int freenect_shutdown(void *context) { return 0; }
void freenect_set_log_level(void *context, int level) {}
void freenect_set_log_callback(void *context, log_cb cb) { log_to = cb; }
void freenect_select_subdevices(void *context, int which) {}
int freenect_num_devices(void *context) { return is("none") ? 0 : 1; }

int freenect_open_device(void *context, void **device, int index)
{
	if (is("denied"))
		log_to(context, 1, "Could not open camera: -3\n");
	if (is("denied") || index > 0)
		return -1;
	*device = &depth;
	return 0;
}

int freenect_open_device_by_camera_serial(void *context, void **device, const char *serial)
{
	return strcmp(serial, "A0001") ? -1 : freenect_open_device(context, device, 0);
}

int freenect_close_device(void *device) { return 0; }

registration_t freenect_copy_registration(void *device)
{
	registration_t r = {.emitter = 7.5f, .colour = 2.3f, .reference_distance = 118.0f,
			    .pixel_size = 0.1f, .const_shift = 200};
	return r;
}

int freenect_destroy_registration(registration_t *r) { return 0; }

static mode_t_ mode(int format, int bytes)
{
	mode_t_ m = {.format = format, .bytes = bytes, .width = 640, .height = 480, .is_valid = 1};
	return m;
}

mode_t_ freenect_find_depth_mode(int resolution, int format) { return mode(format, sizeof depth); }
mode_t_ freenect_find_video_mode(int resolution, int format) { return mode(format, sizeof video); }
int freenect_set_depth_mode(void *device, mode_t_ m) { depth_format = m.format; return 0; }
int freenect_set_video_mode(void *device, mode_t_ m) { return 0; }
void freenect_set_depth_callback(void *device, frame_cb cb) { depth_cb = cb; }
void freenect_set_video_callback(void *device, frame_cb cb) { video_cb = cb; }
int freenect_start_depth(void *device) { depth_runs = 1; return 0; }
int freenect_start_video(void *device) { video_runs = 1; return 0; }
int freenect_stop_depth(void *device) { return 0; }
int freenect_stop_video(void *device) { return 0; }

int freenect_process_events_timeout(void *context, struct timeval *timeout)
{
	while (is("hangs"))
		sleep(1);
	if (is("crashes"))
		abort();
	usleep(33000);
	if (is("gone"))
		log_to(context, 1, "USB device disappeared, cancelling stream :(\n");
	if (!is("there"))
		return 0;
	ticks += 2000000;
	for (int i = 0; i < 640 * 480; i++)
		depth[i] = i % 640 < 320 ? (depth_format == 4 ? 700 : 600) : (depth_format == 4 ? 0 : 2047);
	memset(video, 77, sizeof video);
	if (depth_runs)
		depth_cb(&depth, depth, ticks);
	if (video_runs)
		video_cb(&depth, video, ticks + 100000);
	return 0;
}
