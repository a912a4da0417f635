use super::room::{Object, Room};

/// Flatter things (rugs) can be stood on; higher ones (pictures) are no obstacle.
const OBSTACLES: std::ops::Range<f64> = 0.05..0.5;
/// Distances that are tried, and the clearance that is kept, in metres.
const NEAREST: f64 = 0.5;
const STEP: f64 = 0.1;
const FARTHEST: f64 = 2.5;
const CLEARANCE: f64 = 0.1;
const DIRECTIONS: u32 = 24;

/// Where on the floor, in the room's coordinates, there is space for `object`: the nearest place at least
/// [`NEAREST`] away from where it is, or where it is if there is none.
pub(super) fn free_place(room: &Room, object: &Object) -> [f64; 2] {
    let middle = nalgebra::center(&object.bounds.min, &object.bounds.max);
    let size = object.bounds.size();
    let reach = size.x.max(size.y) / 2.0 + CLEARANCE;
    // The furniture stands along the walls: what it spans is inside the room.
    let all = room.objects().iter().map(|other| &other.bounds);
    let span = |axis: usize| {
        let low = all
            .clone()
            .map(|b| b.min[axis])
            .fold(f64::INFINITY, f64::min);
        let high = all
            .clone()
            .map(|b| b.max[axis])
            .fold(f64::NEG_INFINITY, f64::max);
        [low, high]
    };
    let spans = [span(0), span(1)];
    let obstacles: Vec<_> = (room.objects().iter())
        .filter(|other| other.id != object.id)
        .map(|other| &other.bounds)
        .filter(|b| b.max.z > OBSTACLES.start && b.min.z < OBSTACLES.end)
        .collect();
    let free = |place: [f64; 2]| {
        let inside = |axis: usize, [low, high]: [f64; 2]| {
            place[axis] - reach > low && place[axis] + reach < high
        };
        let within = (0..2).all(|axis| inside(axis, spans[axis]));
        let meets = |axis: usize, low: f64, high: f64| {
            place[axis] - reach < high && place[axis] + reach > low
        };
        let hit = obstacles
            .iter()
            .any(|b| (0..2).all(|axis| meets(axis, b.min[axis], b.max[axis])));
        within && !hit
    };
    let rings = ((FARTHEST - NEAREST) / STEP) as u32;
    (0..rings)
        .flat_map(|ring| (0..DIRECTIONS).map(move |k| (ring, k)))
        .map(|(ring, k)| {
            let distance = NEAREST + STEP * f64::from(ring);
            let angle = f64::from(k) / f64::from(DIRECTIONS) * std::f64::consts::TAU;
            [
                middle.x + distance * angle.cos(),
                middle.y + distance * angle.sin(),
            ]
        })
        .find(|&place| free(place))
        .unwrap_or([middle.x, middle.y])
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_place_is_free_and_not_where_the_object_is() {
        for seed in 0..6 {
            let room = Room::furnish(seed);
            let (inputs, held_out) = room.cameras(12, 4);
            let object = room.showcase_object(&inputs, &held_out).unwrap();
            let [x, y] = free_place(&room, object);
            let middle = nalgebra::center(&object.bounds.min, &object.bounds.max);
            assert!(
                (x - middle.x).hypot(y - middle.y) > NEAREST - 1e-9,
                "seed {seed}"
            );
            for other in room.objects().iter().filter(|other| other.id != object.id) {
                let b = &other.bounds;
                let on_it = (b.min.x..b.max.x).contains(&x) && (b.min.y..b.max.y).contains(&y);
                assert!(
                    !on_it || b.max.z < 0.05 || b.min.z > 0.5,
                    "seed {seed}: {}",
                    other.name
                );
            }
        }
    }
}
