//! Which of the detector's anchors are objects.

/// More candidates than this are not looked at.
const CANDIDATE_LIMIT: usize = 30_000;
/// Boxes of different classes are this far apart, more than any picture is wide.
const CLASS_OFFSET_PX: f32 = 7680.0;

/// An object that the detector has found.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Detection {
    /// The anchor that it comes from.
    pub anchor: usize,
    /// Left, top, right and bottom, in pixels.
    pub corners: [f32; 4],
    /// How sure the detector is, 0 to 1.
    pub score: f32,
    /// What it is of; the object-aware detector knows one class, objects.
    pub class: usize,
}

/// What makes an anchor an object.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct BoxSelection {
    /// The score is above this.
    pub confidence: f32,
    /// Its intersection over union with every surer box is at most this.
    pub iou: f64,
    /// There are no more than this many surer ones.
    pub most: usize,
}

impl BoxSelection {
    /// The objects among the anchors, the surest first: greedy suppression of boxes that overlap
    /// (`ultralytics`' `non_max_suppression`).
    ///
    /// `boxes` are centre x, centre y, width and height of each anchor, `scores` each anchor's scores of all
    /// `classes`, one after another.
    pub fn select(&self, boxes: &[[f32; 4]], scores: &[f32], classes: usize) -> Vec<Detection> {
        let mut candidates: Vec<Detection> = boxes
            .iter()
            .zip(scores.chunks_exact(classes.max(1)))
            .enumerate()
            .filter_map(|(anchor, (bounds, scores))| self.candidate(anchor, bounds, scores))
            .collect();
        // Stable: of equals the earlier anchor comes first.
        candidates.sort_by(|a, b| b.score.total_cmp(&a.score));
        candidates.truncate(CANDIDATE_LIMIT);
        let mut kept: Vec<(Detection, [f32; 4])> = Vec::new();
        for candidate in candidates {
            if kept.len() == self.most {
                break;
            }
            let offset = candidate.class as f32 * CLASS_OFFSET_PX;
            let apart = candidate.corners.map(|value| value + offset);
            let overlaps = |(_, other): &(_, [f32; 4])| f64::from(iou(*other, apart)) > self.iou;
            if !kept.iter().any(overlaps) {
                kept.push((candidate, apart));
            }
        }
        kept.into_iter().map(|(detection, _)| detection).collect()
    }

    fn candidate(&self, anchor: usize, bounds: &[f32; 4], scores: &[f32]) -> Option<Detection> {
        let mut class = 0;
        for (other, &score) in scores.iter().enumerate() {
            if score > scores[class] {
                class = other;
            }
        }
        let score = *scores.get(class)?;
        let &[x, y, width, height] = bounds;
        (score > self.confidence).then_some(Detection {
            anchor,
            corners: [
                x - width / 2.0,
                y - height / 2.0,
                x + width / 2.0,
                y + height / 2.0,
            ],
            score,
            class,
        })
    }
}

/// Intersection over union of two boxes; NaN if both are empty.
fn iou(a: [f32; 4], b: [f32; 4]) -> f32 {
    let area = |[left, top, right, bottom]: [f32; 4]| (right - left) * (bottom - top);
    let width = (a[2].min(b[2]) - a[0].max(b[0])).max(0.0);
    let height = (a[3].min(b[3]) - a[1].max(b[1])).max(0.0);
    let shared = width * height;
    shared / (area(a) + area(b) - shared)
}

#[cfg(test)]
mod tests {
    use super::*;

    const RULE: BoxSelection = BoxSelection {
        confidence: 0.4,
        iou: 0.5,
        most: 300,
    };

    #[test]
    fn the_surer_of_two_boxes_stays() {
        // 10x10 boxes, 2 and 5 to the right of the first: IoU 8/12 and 5/15.
        let boxes = [5.0, 7.0, 10.0].map(|x| [x, 5.0, 10.0, 10.0]);
        let kept = RULE.select(&boxes, &[0.8, 0.9, 0.4], 1);
        assert_eq!(kept.len(), 1, "the third is not above 0.4");
        assert_eq!((kept[0].anchor, kept[0].score), (1, 0.9));
        assert_eq!(kept[0].corners, [2.0, 0.0, 12.0, 10.0]);
        let kept = RULE.select(&boxes, &[0.8, 0.7, 0.6], 1);
        let anchors: Vec<_> = kept.iter().map(|found| found.anchor).collect();
        assert_eq!(anchors, [0, 2]);
    }

    #[test]
    fn an_overlap_of_just_the_limit_is_allowed() {
        // 3x1 boxes, shifted by 1: 2 of 4.
        let boxes = [[1.5, 0.5, 3.0, 1.0], [2.5, 0.5, 3.0, 1.0]];
        assert_eq!(RULE.select(&boxes, &[0.9, 0.8], 1).len(), 2);
    }

    #[test]
    fn classes_do_not_suppress_each_other() {
        let boxes = [[5.0, 5.0, 10.0, 10.0]; 3];
        let kept = RULE.select(&boxes, &[0.5, 0.9, 0.8, 0.1, 0.7, 0.6], 2);
        let found: Vec<_> = kept
            .iter()
            .map(|found| (found.anchor, found.class))
            .collect();
        assert_eq!(found, [(0, 1), (1, 0)]);
        let only = BoxSelection { most: 1, ..RULE };
        assert_eq!(
            only.select(&boxes, &[0.5, 0.9, 0.8, 0.1, 0.7, 0.6], 2)
                .len(),
            1
        );
    }

    #[test]
    fn no_anchor_is_no_object() {
        assert!(RULE.select(&[], &[], 1).is_empty());
        assert!(RULE.select(&[[0.0; 4]], &[f32::NAN], 1).is_empty());
    }
}
